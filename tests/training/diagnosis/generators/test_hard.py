"""The hard cases are what their names say."""

import numpy as np
import pytest
from scipy import stats

from training.diagnosis.generators.hard import HARD


def build(name, seed=0):
    return HARD[name](np.random.default_rng([seed, 3]))


@pytest.mark.parametrize("name", HARD)
def test_every_hard_case_is_a_trial(name):
    trial = build(name)
    assert trial.recorded.reading.echo.any()
    assert len(trial.causes) == (trial.kind == "single")


def test_reflectance_follows_time():
    ping = build("aliased_reflectance").recorded.ping
    assert (np.diff(ping.reflectance) >= 0.0).all()
    assert np.ptp(ping.reflectance) > 0.5


def test_clutter_hides_eight_percent_of_farther_targets():
    trial = build("clutter_before_far_targets")
    for recording, share in ((trial.simulated, 0.0), (trial.recorded, 0.08)):
        far = recording.ping.distance > 0.9
        at = np.abs(recording.reading.range[far] - 0.7) < 0.04
        assert np.mean(at) == pytest.approx(share, abs=0.025)


def test_the_set_of_forty_has_forty_and_the_long_set_three_thousand():
    assert len(build("forty_pings").recorded) == 40
    assert len(build("ten_marks").recorded) == 3000


@pytest.mark.parametrize("name", ["matched_scale", "matched_offset"])
def test_pooled_readings_agree_although_the_errors_differ(name):
    trial = build(name)
    echoes = [r.reading.range[r.reading.echo] for r in (trial.simulated, trial.recorded)]
    assert stats.ks_2samp(*echoes).statistic < 0.05
    assert echoes[1].mean() == pytest.approx(echoes[0].mean(), abs=0.02)
    errors = [np.median((r.reading.range - r.ping.distance)[r.reading.echo]) for r in (trial.simulated, trial.recorded)]
    assert errors[1] - errors[0] > 0.008
