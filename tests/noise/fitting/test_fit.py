"""Maximum likelihood: gradients, known parameters, calibrated uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from acquisition import Ping, Reading, Recording
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit, Objective, covariance, fit, maximise, refit_without_urn
from noise.fitting.likelihood import log_likelihood
from noise.fitting.stack import NUISANCES, Stack
from noise.fitting.starts import extra_modes, nuisance_start, starting_points
from noise.physical import PhysicalModel

torch.set_num_threads(1)


def recording_of(seed, visits=60, pings=6, placement=0.003, **effects):
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.3, 4.0, visits), pings)
    moved = distance + np.repeat(rng.normal(0, placement, visits), pings)
    model = PhysicalModel(
        [CATALOGUE["travel_time_jitter"](sigma_m=0.004)] + [CATALOGUE[k](**v) for k, v in effects.items()]
    )
    return Recording.of(Ping.of(distance=distance), model.law(Ping.of(distance=moved)).sample(rng))


def test_gradient_equals_finite_differences():
    batch = Batch.of(recording_of(0, clock_scale={"error": 0.01}, spike={"probability": 0.02}))
    batch = replace(batch, simulated_offset=np.where(batch.visit % 3 == 0, np.nan, 0.001 * (batch.visit % 5 - 2)))
    free = (("clock_scale", "error"), ("spike", "probability"), *NUISANCES)
    stack = nuisance_start(Stack.of(PhysicalModel()), batch).put(free[:2], [0.004, 0.01])
    stack = stack.put([("travel_time_jitter", "per_metre")], [0.002])
    objective = Objective(stack, free, batch)
    x = np.array([stack.get(key) for key in free])
    _, gradient = objective(x)
    for j in range(len(x)):
        step = np.zeros_like(x)
        step[j] = 1e-6 * max(abs(x[j]), 1e-2)
        slope = (objective(x + step)[0] - objective(x - step)[0]) / (2 * step[j])
        assert gradient[j] == pytest.approx(slope, rel=1e-3, abs=1e-2)


def test_a_discontinuity_does_not_end_a_fit():
    # ring-down is read from 0.2 m on: a later start excludes some readings, although the gradient favours it
    rng = np.random.default_rng(5)
    distance = np.repeat(rng.uniform(0.8, 1.5, 40), 6)
    range_ = distance + rng.normal(0.01, 0.004, len(distance))
    range_[::9] = 0.2 - 0.04 * np.log(1.0 - np.arange(len(range_[::9])) / len(range_[::9]))
    batch = Batch.of(Recording.of(Ping.of(distance=distance), Reading.of(np.round(range_, 3))))
    begin, offset, often = ("ring_down", "range_m"), ("zero_offset", "offset_m"), ("ring_down", "probability")
    free = (begin, offset, often, ("travel_time_jitter", "sigma_m"))
    values = [0.2 - 0.51 * batch.resolution, 0.0, 0.1, 0.04]
    start = nuisance_start(Stack.of(PhysicalModel()), batch).put([*free[:3], ("ring_down", "decay_m")], values)
    edge = Objective(start, free, batch)
    x = np.array([start.get(key) for key in free])
    later = x + np.array([2.0 * batch.resolution, 0.0, 0.0, 0.0])
    assert edge(x)[1][0] < 0  # the gradient favours a later start
    assert edge(later)[0] > edge(x)[0]
    found, fixed = maximise(start, free, batch), maximise(start, free[1:], batch)
    assert found.nats > fixed.nats - 0.1
    assert found.stack.get(offset) == pytest.approx(0.01, abs=0.002)
    alone = maximise(start, free[:1], batch).stack.get(begin)  # it ends at the edge of the nearest reading
    assert alone == pytest.approx(0.2 - 0.5 * batch.resolution, abs=1e-6)


@pytest.mark.parametrize("span", [0.5, 4.0, 11.0])
def test_random_readings_are_uniform_up_to_a_soft_end(span):
    spike = PhysicalModel([CATALOGUE["spike"](probability=0.5, span_m=span)]).law(Ping.of(distance=np.full(2, 15.0)))
    at = span * np.array([0.2, 0.5, 0.8, 1.0, 1.3])
    below = np.array([float(spike.cdf(np.full(2, z))[0]) for z in at])
    assert below[:3] == pytest.approx(0.5 * at[:3] / span, abs=0.005)
    assert below[3:] == pytest.approx([0.5, 0.5], abs=0.02)
    assert below[3] < below[4]


def test_known_parameters_lie_within_their_standard_errors():
    recording = recording_of(1, clock_scale={"error": -0.01}, zero_offset={"offset_m": 0.012})
    found = fit(PhysicalModel([CATALOGUE["clock_scale"](), CATALOGUE["zero_offset"]()]), recording)
    spread = np.sqrt(np.diag(covariance(found, Batch.of(recording))))
    truth = {("clock_scale", "error"): -0.01, ("zero_offset", "offset_m"): 0.012}
    for key, sd in zip(found.free, spread, strict=True):
        if key in truth:
            assert abs(found.stack.get(key) - truth[key]) < 4 * sd
            assert 0 < sd < 0.005
    assert found.stack.get(("visits", "placement_m")) == pytest.approx(0.003, rel=0.5)
    assert found.stack.get(("travel_time_jitter", "sigma_m")) == pytest.approx(0.004, rel=0.2)


@pytest.mark.slow
def test_intervals_cover_the_truth_when_pings_of_a_visit_share_an_offset():
    # 20 recordings, 90 % intervals: fewer than 14 covered has probability 0.002 at true 90 %
    inside = 0
    for seed in range(20):
        recording = recording_of(100 + seed, visits=25, pings=5, placement=0.006, zero_offset={"offset_m": 0.01})
        found = fit(PhysicalModel([CATALOGUE["zero_offset"]()]), recording, iterations=40)
        sd = np.sqrt(covariance(found, Batch.of(recording))[0, 0])
        inside += abs(found.stack.get(("zero_offset", "offset_m")) - 0.01) < 1.645 * sd
    assert inside >= 14


def test_pieces_of_one_run_of_a_robot_are_no_independent_evidence():
    # 12 runs of 10 places, and one error of the pose in each run: the mean is as uncertain as that of 12 errors
    rng, sd = np.random.default_rng(5), 0.02
    run = np.repeat(np.arange(12), 10)
    ping = Ping.of(distance=rng.uniform(0.5, 3.0, 120), time=np.arange(120) * 20.0, run=run)
    truth = rng.normal(0.0, sd, 12)[run]
    moved = np.round(ping.distance + truth + rng.normal(0.0, 0.001, 120), 3)
    piece = np.arange(120)
    batch = replace(Batch.of(Recording.of(ping, Reading.of(moved))), by_run=True, visit=piece, condition=piece)
    key = ("zero_offset", "offset_m")
    start = Stack.of(PhysicalModel()).at({("travel_time_jitter", "sigma_m"): sd})
    by_run, by_visit = (
        np.sqrt(covariance(maximise(start, [key], each), each)[0, 0]) for each in (batch, replace(batch, by_run=False))
    )
    assert by_visit == pytest.approx(np.std(truth) / np.sqrt(120), rel=0.3)
    assert by_run == pytest.approx(np.std(truth) / np.sqrt(12), rel=0.3)


def test_a_fit_is_never_worse_than_its_start():
    batch = Batch.of(recording_of(2))
    stack = nuisance_start(Stack.of(PhysicalModel()), batch)
    assert maximise(stack, NUISANCES, batch).nats >= log_likelihood(stack, batch).sum()


def test_extra_modes_are_found():
    recording = recording_of(3, fixed_clutter={"presence": 0.3, "range_m": 0.2, "spread_m": 0.005})
    modes = extra_modes(Batch.of(recording))
    assert min(abs(m - 0.2) for m in modes) <= 0.026
    stack = Stack.of(PhysicalModel())
    starts = starting_points(stack, "fixed_clutter", Batch.of(recording), np.random.default_rng(0))
    assert min(abs(s.get(("fixed_clutter", "range_m")) - 0.2) for s in starts) <= 0.026


def test_a_fit_leaves_the_lower_bound_of_the_placement_error():
    batch, key = Batch.of(recording_of(7)), ("visits", "placement_m")
    stack = nuisance_start(Stack.of(PhysicalModel()), batch)
    optima = [maximise(stack.put([key], [p]), NUISANCES, batch) for p in (stack.parameter(key).low, 0.003)]
    assert optima[0].nats == pytest.approx(optima[1].nats, abs=0.1)
    assert optima[0].stack.get(key) > 0.001


@pytest.mark.parametrize("seed", range(3))
def test_the_probability_of_outliers_refers_to_all_pings_although_readings_repeat(seed):
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.3, 3.0, 72), 15)
    error = np.repeat(rng.normal(0, 0.006, 72), 15) + rng.normal(0, 0.0003, len(distance))
    outlier = rng.random(len(distance)) < 0.012
    reading = np.where(outlier, distance + rng.uniform(0.2, 7.0, len(distance)), distance + error)
    batch = Batch.of(Recording.of(Ping.of(distance=distance), Reading.of(np.round(reading, 4))))
    keys = (("spike", "probability"), ("spike", "span_m"))
    visits = {"placement_m": 0.006, "urn_weight": 3.0, "urn_width_m": 0.0003, "level_sd_db": 0.0}
    spike = {"probability": 0.1, "span_m": 8.0}
    joint = maximise(
        Stack({"travel_time_jitter": {"sigma_m": 0.004}, "spike": spike, "visits": visits}),
        (*keys, *(key for key in NUISANCES if key != ("visits", "urn_weight"))),
        batch,
        80,
    )
    assert joint.stack.get(keys[0]) > 4.0 * outlier.mean()  # most new readings of a visit are outliers
    assert refit_without_urn(joint, keys, batch).stack.get(keys[0]) == pytest.approx(outlier.mean(), rel=1.5)


def test_a_refit_that_loses_an_effect_is_rejected():
    batch = Batch.of(recording_of(3, placement=0.003))
    visits = {"placement_m": 0.003, "urn_weight": 3.0}
    found = Stack({"travel_time_jitter": {"sigma_m": 0.004}, "spike": {"probability": 0.1}, "visits": visits})
    joint = Fit(found, (), 0.0)
    # there are no outliers, so that the probability of the refit is zero
    assert refit_without_urn(joint, (("spike", "probability"),), batch) is joint


def test_nuisances_are_expected_where_another_recording_has_them_and_effects_are_not():
    keys = (("visits", "placement_m"), ("clock_scale", "error"))
    stack = replace(Stack.of(PhysicalModel()), familiar={keys[0]: 0.003})

    def prior(placement, error):
        return float(stack.log_prior(keys, torch.tensor([placement, error], dtype=torch.float64)))

    assert prior(0.003, 0.0) == 0.0
    assert prior(0.03, 0.0) < prior(0.01, 0.0) < 0.0
    assert prior(0.01, 0.02) == prior(0.01, 0.0)
