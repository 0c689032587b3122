"""A logged thermometer tells air from clock: only one of them follows it."""

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise.discrepancy import diagnose
from noise.effects import CATALOGUE
from noise.physical import PhysicalModel

HELD = {
    "sensitivity": {"loss_db": 36.0},
    "specular_loss": {"strength": 0.5},
    "travel_time_jitter": {"sigma_m": 0.004},
}


def heard(swing_k):
    """Return readings of a sonar that knows nothing of the air, in air of 20 degC and a swing about it."""
    rng = np.random.default_rng(7)
    cells, each = 40, 10
    distance = np.repeat(rng.uniform(0.4, 3.0, cells), each)
    logged = np.repeat(rng.permutation(np.linspace(20.0 - swing_k, 20.0 + swing_k, cells)), each)
    ping = Ping.of(distance=distance, time=np.arange(len(distance)) * 0.065, temperature_c=np.round(logged, 1))
    air = CATALOGUE["sound_speed"](temperature_c=20.0, logged_share=1.0)
    return Recording.of(ping, PhysicalModel([*held(), air]).law(ping).sample(rng))


def held():
    return [CATALOGUE[name](**values) for name, values in HELD.items()]


@pytest.mark.slow
def test_air_is_told_from_clock_where_the_temperature_varies():
    verdict = diagnose(PhysicalModel(held()), heard(15.0), seed=0).verdict
    assert verdict.verdict == "named"
    assert [named.effect for named in verdict.effects] == ["sound_speed"]
    share = verdict.effects[0].parameters["logged_share"]
    assert share.low < 1.0 < share.high
    assert share.high - share.low < 0.2


@pytest.mark.slow
def test_air_is_not_told_from_clock_where_it_does_not():
    verdict = diagnose(PhysicalModel(held()), heard(0.2), seed=0).verdict
    assert verdict.verdict == "confounded"
    told = {verdict.effects[0].effect, *verdict.effects[0].indistinguishable_from}
    assert {"sound_speed", "clock_scale"} <= told
    assert "logged_share" not in verdict.effects[0].parameters
