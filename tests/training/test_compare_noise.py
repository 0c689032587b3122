"""Models between two known ends: on data whose law is known, the scale reads what it must."""

import numpy as np
import pytest

from acquisition import Ping, Recording, SettingError
from noise import GaussianModel, simulate
from noise.beam import BeamModel
from training.compare_noise import GAUSSIAN, compare, halves, repeatability, rows

STEP = 0.01
TRUTH = BeamModel(0.8, 0.05, 0.1, 0.05, sigma=0.03, resolution=STEP)


def recorded(seed, cells=60, pings=40, model=TRUTH):
    rng = np.random.default_rng(seed)
    ping = Ping.of(distance=np.repeat(rng.uniform(0.5, 4.0, cells).round(2), pings))
    return Recording.of(ping, simulate(model, ping, rng))


def test_the_true_law_beats_the_gaussian_and_the_fitted_beam_model_comes_near():
    scores = compare(recorded(0), recorded(1), {"truth": TRUTH}).scores
    best = scores["truth"].log_likelihood.mean
    assert best > scores[GAUSSIAN].log_likelihood.mean + 0.3
    assert scores["beam model, by EM"].log_likelihood.mean == pytest.approx(best, abs=0.02)
    assert scores["truth"].credence_gap < 0.03


def test_a_sensor_that_always_repeats_itself_is_worth_nearly_everything():
    certain = GaussianModel(sigma=1e-9, sigma_per_metre=0.0, resolution=STEP)
    test = recorded(2, model=certain, pings=20)
    fresh = halves(test.cell)
    value = repeatability(test, fresh, TRUTH)
    assert np.all(value >= np.log(10 / 11)), "ten pings alike, and a prior worth one"
    assert np.all(value < 0)


def test_the_way_is_nothing_at_the_gaussian_and_everything_at_the_repeatability():
    compared = compare(recorded(3), recorded(4), {})
    assert compared.way(GAUSSIAN) == 0.0
    assert rows(compared)[-1][2] == "100 %"
    assert [row[0] for row in rows(compared)][:3] == ["ideal", GAUSSIAN, "beam model, by EM"]


def test_registers_that_differ_are_refused():
    with pytest.raises(SettingError, match="counts in steps of 1 mm"):
        compare(recorded(0, cells=5), recorded(1, cells=5), {"fine": GaussianModel(resolution=0.001)})
