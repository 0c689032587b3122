"""The period of another sonar is estimated from readings, however regular the pings are."""

import numpy as np
import pytest

from noise.effects import CATALOGUE
from noise.effects.base import EchoSample
from noise.effects.medium import ASSUMED_SPEED

CLOCK = CATALOGUE["asynchronous_crosstalk"]
VISIT = 20  # pings


def echoes(seed, pace, period, jitter=0.0, error=0.0):
    """Return echoes of a survey with a ping interval `pace`, s; half of the bursts of another sonar are received."""
    rng = np.random.default_rng(seed)
    gaps = pace + rng.normal(0.0, jitter, 1500)
    gaps[::VISIT] += rng.uniform(2.0, 30.0, len(gaps[::VISIT])).round(1)
    time = np.cumsum(gaps).round(3)
    distance = np.repeat(rng.uniform(0.3, 4.0, 75), VISIT)
    late = np.mod(rng.uniform(0.0, period) - time, period) + rng.normal(0.0, error, len(time))
    reading = 0.5 * ASSUMED_SPEED * late
    hit = (late > 1e-3) & (reading < distance - 0.15) & (rng.random(len(time)) < 0.5)
    return EchoSample(distance, time, np.where(hit, reading, distance))


@pytest.mark.parametrize("jitter", [0.0, 0.002])
@pytest.mark.parametrize(("pace", "period"), [(0.1, 0.1332), (0.1, 0.0713), (0.1, 0.3017), (0.065, 0.0871)])
def test_the_period_is_estimated_and_neither_a_multiple_of_it_nor_the_ping_interval(pace, period, jitter):
    (guess,) = CLOCK.guesses(echoes(1, pace, period, jitter, error=2e-4))
    assert guess["period_s"] == pytest.approx(period, rel=2e-5)
