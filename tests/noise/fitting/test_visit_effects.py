"""Prequential likelihood: known answers and laws."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from acquisition import Ping, Reading, Recording
from noise.discrepancy.name.candidates import keys_of
from noise.effects import CATALOGUE
from noise.effects.receiver import WALK_DB, WALK_M
from noise.fitting.batch import Batch
from noise.fitting.fit import maximise
from noise.fitting.stack import LEVEL_SD, NUISANCES, PLACEMENT, Stack
from noise.fitting.starts import nuisance_starts, starting_points
from noise.fitting.visit_effects import VisitEffects, law_of, log_prob, single_ping_law
from noise.physical import PhysicalModel

STEP = 0.001


def jittering(sigma):
    return PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=sigma)], resolution=STEP, max_range=4.0)


def recording_of(distance, range_, **columns):
    return Recording.of(Ping.of(distance=distance), Reading.of(np.round(range_, 3)), **columns)


def test_a_shared_offset_makes_readings_jointly_normal():
    # covariance sigma^2 I + tau^2 1 1': the predictions multiply to the joint density, up to the floor
    sigma, tau, n = 0.02, 0.03, 9
    rng = np.random.default_rng(3)
    batch = Batch.of(recording_of(np.full(n, 2.0), 2.0 + tau * 0.8 + rng.normal(0, sigma, n)))
    visits = VisitEffects(placement_m=tau, ping_correlation=0.0, urn_weight=0.0)
    found = float(log_prob(law_of(jittering(sigma), batch), visits, batch).sum())
    covariance = sigma**2 * np.eye(n) + tau**2
    exact = stats.multivariate_normal(np.full(n, 2.0), covariance).logpdf(batch.reading.range) + n * np.log(STEP)
    assert found == pytest.approx(exact, abs=0.15)


def test_the_level_of_a_visit_offsets_its_readings_by_the_time_walk():
    # readings are as late as the table says at the level of a wall, give or take 3 dB: weak visits scatter most
    rng, n_visits, n_each = np.random.default_rng(4), 300, 5
    wall = rng.uniform(0.1, 1.5, n_visits).round(3)
    level = 10.0 - 20.0 * np.log10(wall) + rng.normal(0.0, 3.0, n_visits)
    distance, late = np.repeat([wall, np.interp(level, WALK_DB, WALK_M)], n_each, axis=1)
    readings = distance + late + rng.normal(0.0, 0.004, len(late))
    batch = Batch.of(recording_of(distance, readings, run=np.repeat(np.arange(n_visits), n_each)))
    effects = {"time_walk": {"scale": 1.0}, "sensitivity": {"loss_db": 50.0}, "travel_time_jitter": {"sigma_m": 0.004}}
    stack = Stack.of(PhysicalModel([CATALOGUE[name](**v) for name, v in effects.items()], resolution=STEP))
    fit = maximise(stack.at({LEVEL_SD: 1.0}), [LEVEL_SD, PLACEMENT], batch, 60)
    assert 2.0 < fit.stack.get(LEVEL_SD) < 4.5
    assert fit.stack.get(PLACEMENT) < 0.003
    one = single_ping_law(law_of(fit.stack.model, batch), fit.stack.build()[1])
    for part in (batch.ping.distance < 0.3, batch.ping.distance > 1.0):
        spread = np.mean((one.quantile(0.84) - one.quantile(0.16))[part]) / 2
        assert spread == pytest.approx(np.std((batch.reading.range - one.quantile(0.5))[part]), rel=0.25)


@settings(max_examples=15, deadline=None)
@given(
    placement=st.floats(2e-4, 0.05),
    correlation=st.floats(0.0, 0.9),
    urn=st.floats(0.0, 4.0),
    width=st.floats(0.001, 0.02),
    detection=st.floats(0.0, 4.0),
)
def test_every_prediction_sums_to_one(placement, correlation, urn, width, detection):
    # the third ping of a visit, after an echo and a ping without echo: sum over all outcomes
    model = PhysicalModel(
        [CATALOGUE["travel_time_jitter"](sigma_m=0.02), CATALOGUE["dropped_reading"](probability=0.2)],
        resolution=0.01,
        max_range=1.0,
    )
    visits = VisitEffects(
        placement_m=placement,
        ping_correlation=correlation,
        urn_weight=urn,
        urn_width_m=width,
        level_sd_db=detection,
    )
    last = np.arange(101) * 0.01
    range_ = np.stack([np.full(101, 0.52), np.zeros(101), last], axis=1).ravel()
    reading, visit = Reading.of(range_), np.repeat(np.arange(101), 3)
    batch = Batch(
        Ping.of(distance=np.full(303, 0.5)),
        reading,
        reading,
        visit,
        visit,
        0.01,
        np.full((303, 2), np.nan),
        np.zeros(303),
    )
    p = torch.exp(log_prob(law_of(model, batch), visits, batch))
    assert float(p[2::3].sum()) == pytest.approx(1.0, abs=1e-6)


def near_threshold(loss_db, range_):
    model = PhysicalModel(
        [CATALOGUE["travel_time_jitter"](sigma_m=0.005), CATALOGUE["sensitivity"](loss_db=loss_db)],
        resolution=STEP,
        max_range=4.0,
    )
    batch = Batch.of(recording_of(np.full(len(range_), 2.0), range_))
    return law_of(model, batch), batch


@pytest.mark.parametrize("loss_db", [20.0, 48.0, 60.0, 75.0, 79.0])
def test_echo_and_no_echo_are_exact_however_rare_either_is(loss_db):
    law, _ = near_threshold(loss_db, np.full(1, 2.0))
    path = law.state.direct
    margin = float(path.level_db[0, 0] / law.state.width_db)
    assert float(law.any_echo_tensor()[0]) == pytest.approx(stats.norm.cdf(margin), rel=1e-9)
    assert float(law.no_echo_tensor()[0]) == pytest.approx(stats.norm.sf(margin), rel=1e-9)


@pytest.mark.parametrize(("loss_db", "range_"), [(0.0, 0.0), (79.0, 2.0)])
def test_a_visit_with_an_improbable_outcome_counts_once(loss_db, range_):
    law, batch = near_threshold(loss_db, np.full(25, range_))
    odds = law.no_echo_tensor() if range_ == 0.0 else law.any_echo_tensor()
    assert float(odds[0]) < 1e-12
    each = log_prob(law, VisitEffects(level_sd_db=1.0, placement_m=0.002), batch).numpy()
    assert each[0] < -7.0
    # the other 24 equal outcomes cost what the rule of succession predicts
    assert each[1:].sum() > -15.0


def test_a_repeated_reading_counts_about_once():
    # with the urn, twenty equal outliers cost little more than the first
    batch = Batch.of(recording_of(np.full(20, 2.0), np.full(20, 1.0)))
    model = jittering(0.005)
    without, with_urn = (
        float(log_prob(law_of(model, batch), VisitEffects(urn_weight=w, urn_width_m=0.002), batch).sum())
        for w in (0.0, 1.0)
    )
    first = float(log_prob(law_of(model, batch), VisitEffects(), batch)[0])
    assert without == pytest.approx(20 * first, rel=0.01)
    assert with_urn > 4 * first


def test_a_misplaced_target_counts_about_once():
    # 60 mm off with 2 mm of placement: its readings agree with each other, and cost little more than the first
    rng = np.random.default_rng(0)
    batch = Batch.of(recording_of(np.full(50, 2.0), np.round(2.06 + 0.005 * rng.standard_normal(50), 3)))
    each = log_prob(law_of(jittering(0.005), batch), VisitEffects(placement_m=0.002), batch).numpy()
    right = log_prob(law_of(jittering(0.005), batch), VisitEffects(placement_m=0.06), batch).numpy()
    assert each.sum() > right.sum() - 20.0


@pytest.mark.parametrize("name", CATALOGUE)
def test_gradients_are_numbers_where_a_law_that_misses_nothing_meets_silence(name):
    rng = np.random.default_rng(0)
    distance = np.repeat(rng.uniform(0.3, 5.0, 24), 5)
    ping = Ping.of(distance=distance, angle=np.repeat(rng.uniform(-0.5, 0.5, 24), 5), time=np.arange(120) * 10.0)
    read = np.round(distance + rng.normal(0.0, 0.005, 120), 3)
    batch = Batch.of(Recording.of(ping, Reading.of(np.where(rng.random(120) < 0.1, 0.0, read))))
    for near in nuisance_starts(Stack.of(PhysicalModel()), batch):
        for start in starting_points(near, name, batch, rng, 2):
            free = [*keys_of(start, name, batch), *NUISANCES]
            numbers = torch.tensor([start.get(key) for key in free], dtype=torch.float64, requires_grad=True)
            model, visits = start.build(free, numbers)
            nats = log_prob(law_of(model, batch), visits, batch).sum()
            (gradient,) = torch.autograd.grad(nats, numbers)
            assert torch.isfinite(nats)
            assert torch.isfinite(gradient).all()
