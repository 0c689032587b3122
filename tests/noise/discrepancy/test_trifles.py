"""A difference that is significant but smaller than two recordings of one sonar differ by is named, and no verdict."""

from dataclasses import replace

import numpy as np

import noise
from acquisition import Ping, Recording
from noise.discrepancy.result import Aspect, Kind
from noise.discrepancy.thresholds import SPREAD_TOLERANCE
from noise.effects import CATALOGUE
from noise.physical import PhysicalModel

OFFSET_M = 0.001


def test_an_offset_of_a_millimetre_is_told_with_its_size_and_changes_nothing():
    rng, model = np.random.default_rng(0), noise.GaussianModel(sigma=0.003, sigma_per_metre=0.0)
    ping = Ping.of(np.repeat(rng.uniform(0.5, 3.0, 200), 10), time=np.arange(2000) * 0.1)
    reading = noise.simulate(model, replace(ping, distance=ping.distance + OFFSET_M), rng)
    found = noise.diagnose(model, Recording.of(ping, reading))
    assert found.verdict.verdict is Kind.NONE
    assert found.corrected is None
    assert found.verdict.where == ()
    (trifle,) = found.verdict.unexplained.where
    assert trifle.aspect is Aspect.BIAS
    assert trifle.size.low < OFFSET_M < trifle.size.high
    assert "  too small to matter: Echoes read 0." in found.summary()
    assert found.verdict.to_dict()["unexplained"]["where"][0]["unit"] == "mm"


def test_a_trifle_does_not_hide_what_differs_beside_it():
    rng, jitter = np.random.default_rng(1), CATALOGUE["travel_time_jitter"](sigma_m=0.004)
    distance = 0.4 + 0.001 * np.random.default_rng(5).choice(2100, 100, replace=False)
    ping = Ping.of(np.repeat(distance, 20), time=np.arange(2000) * 1.0)
    burst = CATALOGUE["noise_burst"](probability=0.04, sigma_m=0.016)
    found = noise.diagnose(
        PhysicalModel([jitter]), Recording.of(ping, noise.simulate(PhysicalModel([jitter, burst]), ping, rng))
    )
    spread = found.verdict.where[0]
    assert spread.aspect is Aspect.SPREAD
    assert spread.size.value < SPREAD_TOLERANCE
    assert found.verdict.verdict not in (Kind.NONE, Kind.TOO_LITTLE_DATA)
