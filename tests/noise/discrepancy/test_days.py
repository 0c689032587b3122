"""Recordings of two days: another temperature is no difference, and hides none."""

from dataclasses import replace

import numpy as np
import pytest

import noise
from tests.noise.discrepancy.made import recording_of

FAULTS = {"zero_offset": {"offset_m": 0.03}, "dropped_reading": {"probability": 0.1}}


def on_a_day(recording, temperature_c, seed):
    """Return a recording with a logged temperature."""
    logged = temperature_c + np.random.default_rng(seed).normal(0.0, 0.1, len(recording)).round(1)
    return replace(recording, table=recording.table.assign(temperature_c=logged))


@pytest.mark.parametrize("faults", [FAULTS, {}])
@pytest.mark.slow
def test_faults_are_named_on_a_day_of_another_temperature(faults):
    """The positions differ too, so that nothing is measured twice."""
    simulated = on_a_day(recording_of({}, seed=1, visits=60, pings=8), 18.0, 1)
    recorded = on_a_day(recording_of(faults, seed=2, visits=60, pings=8), 20.0, 2)
    found = noise.diagnose("ideal", recorded, simulated=simulated).verdict
    assert {cause.effect for cause in found.causes} == set(faults)
    assert str(found.verdict) == ("explained" if faults else "none")
