"""Models between two known ends: on data whose law is known, the scale reads what it must."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording, SettingError
from noise import GaussianModel, simulate
from noise.beam import BeamModel
from training.noise.baselines import CellModel
from training.noise.compare import BEAM, GAUSSIAN, baselines, compare, halves, repeatability, rows

STEP = 0.01
TRUTH = BeamModel(0.8, 0.05, 0.1, 0.05, sigma=0.03, resolution=STEP)


def recorded(seed, cells=60, pings=40, model=TRUTH):
    rng = np.random.default_rng(seed)
    ping = Ping.of(distance=np.repeat(rng.uniform(0.5, 4.0, cells).round(2), pings))
    return Recording.of(ping, simulate(model, ping, rng))


@pytest.fixture(scope="module")
def fitted():
    return baselines(recorded(0))


def test_the_true_law_beats_the_gaussian_and_what_can_say_it_comes_near(fitted):
    scores = compare(recorded(1), {**fitted, "truth": TRUTH}).scores
    best = scores["truth"].log_likelihood.mean
    assert best > scores[GAUSSIAN].log_likelihood.mean + 0.3
    assert scores[BEAM].log_likelihood.mean == pytest.approx(best, abs=0.02)
    # 40 pings of each of 60 conditions make a rough law, that of the nearest condition; it is a law all the same
    assert best - 1.5 < scores["each condition as recorded"].log_likelihood.mean < best
    assert scores["physics, fitted"].log_likelihood.mean > scores[GAUSSIAN].log_likelihood.mean
    assert scores["truth"].credence_gap < 0.03


def test_a_condition_as_recorded_is_what_was_read_in_it():
    ping = Ping.of([1.0, 1.0, 1.0, 1.0, 2.0, 2.0])
    model = CellModel.of(Recording.of(ping, Reading.of([1.01, 1.01, 1.03, 0.0, 2.0, 2.0])), replace(TRUTH, silent=0.1))
    law = model.law(Ping.of([1.0, 1.0, 1.0, 1.0, 1.12]))
    got = np.exp(law.log_prob(Reading.of([1.01, 1.03, 0.0, 1.02, 1.13])))
    smooth = np.exp(TRUTH.law(Ping.of([1.0, 1.0, 1.0, 1.0, 1.12])).log_prob(Reading.of([1.01, 1.03, 0.0, 1.02, 1.13])))
    np.testing.assert_allclose(got, 0.8 * np.array([0.5, 0.25, 0.25, 0.0, 0.5]) + 0.2 * smooth, atol=1e-9)


def test_a_sensor_that_always_repeats_itself_is_worth_nearly_everything():
    certain = GaussianModel(sigma=1e-9, sigma_per_metre=0.0, resolution=STEP)
    test = recorded(2, model=certain, pings=20)
    fresh = halves(test.condition)
    value = repeatability(test, fresh, TRUTH)
    assert np.all(value >= np.log(19 / 20)), "19 other pings alike, and a prior worth one"
    assert np.all(value < 0)


def test_the_way_is_nothing_at_the_gaussian_and_everything_at_the_repeatability(fitted):
    compared = compare(recorded(4), fitted)
    assert compared.way(GAUSSIAN) == 0.0
    assert rows(compared)[-1][2] == "100 %"
    assert [row[0] for row in rows(compared)][:3] == ["ideal", GAUSSIAN, BEAM]


def test_registers_that_differ_are_refused():
    with pytest.raises(SettingError, match="counts in steps of 1 mm"):
        compare(recorded(1, cells=5), {"fine": GaussianModel(resolution=0.001)})
