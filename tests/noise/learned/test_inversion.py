"""Sampling by inversion: closed forms and wide searches agree with bisection."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import Ping
from noise import CATALOGUE, GaussianModel, IdealModel, PhysicalModel
from noise import law as law_module
from noise.law import EchoLaw

SHARE = st.floats(0.0, 1.0, exclude_max=True)


@given(st.lists(st.tuples(st.floats(0.01, 8.0), SHARE), min_size=1, max_size=20), st.floats(0.0, 0.9))
def test_closed_form_agrees_with_the_search(pairs, miss):
    distance, u = np.array(pairs).T
    law = GaussianModel(sigma=0.01, sigma_per_metre=0.01, miss=miss).law(Ping.of(distance=distance))
    chosen = u * law.echo
    found, searched = law._invert(chosen), EchoLaw._invert(law, chosen)
    # the cdf is constant in the far tails, where any step is right up to rounding
    same = np.abs(law.cdf_step(found) - law.cdf_step(searched)) < 1e-12
    assert np.all(same | (found == searched))


def test_sonar_without_noise_reads_the_nearest_step():
    distance = np.random.default_rng(0).uniform(0.01, 8.0, 500)
    law = IdealModel().law(Ping.of(distance=distance))
    assert np.array_equal(law._invert(np.full(500, 0.5)), EchoLaw._invert(law, np.full(500, 0.5)))


@pytest.mark.parametrize("resolution", [0.001, 0.01, 0.0254])
def test_wide_search_agrees_with_bisection(resolution, monkeypatch):
    effects = [
        CATALOGUE["sensitivity"](loss_db=40.0),
        CATALOGUE["travel_time_jitter"](sigma_m=0.004),
        CATALOGUE["spike"](probability=0.1, span_m=6.0),
    ]
    rng = np.random.default_rng(0)
    law = PhysicalModel(effects, resolution=resolution).law(Ping.of(distance=rng.uniform(0.05, 3.0, 50)))
    u = rng.random((20, 50)) * law.echo
    wide = [law._invert(row) for row in u]
    monkeypatch.setattr(law_module, "MAX_N_WIDE", 0)
    assert np.array_equal(wide, [law._invert(row) for row in u])
    assert np.array_equal(wide, law._invert(u))


def test_drawn_readings_follow_the_closed_form_law():
    law = GaussianModel(sigma=0.02, sigma_per_metre=0.0, miss=0.3).law(Ping.of(distance=np.full(40_000, 1.0)))
    reading = law.sample(np.random.default_rng(0))
    assert reading.echo.mean() == pytest.approx(0.7, abs=0.01)
    assert reading.range[reading.echo].mean() == pytest.approx(1.0, abs=5e-4)
    assert reading.range[reading.echo].std() == pytest.approx(0.02, rel=0.02)
