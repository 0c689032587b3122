"""Another sonar's clock is found among readings, however evenly this one pings."""

import numpy as np
import pytest

from noise.effects import CATALOGUE
from noise.effects.base import Seen
from noise.effects.medium import ASSUMED_SPEED

CLOCK = CATALOGUE["asynchronous_crosstalk"]
STAY = 20  # pings


def heard(seed, pace, period, jitter=0.0, error=0.0):
    """Return readings of a survey that pings at a pace, beside a sonar of another, in half of its bursts."""
    rng = np.random.default_rng(seed)
    gaps = pace + rng.normal(0.0, jitter, 1500)
    gaps[::STAY] += rng.uniform(2.0, 30.0, len(gaps[::STAY])).round(1)
    time = np.cumsum(gaps).round(3)
    distance = np.repeat(rng.uniform(0.3, 4.0, 75), STAY)
    late = np.mod(rng.uniform(0.0, period) - time, period) + rng.normal(0.0, error, len(time))
    reading = 0.5 * ASSUMED_SPEED * late
    hit = (late > 1e-3) & (reading < distance - 0.15) & (rng.random(len(time)) < 0.5)
    return Seen(distance, time, np.where(hit, reading, distance))


@pytest.mark.parametrize("jitter", [0.0, 0.002])
@pytest.mark.parametrize(("pace", "period"), [(0.1, 0.1332), (0.1, 0.0713), (0.1, 0.3017), (0.065, 0.0871)])
def test_its_clock_is_found_at_any_pace_and_not_a_multiple_of_it_nor_ones_own(pace, period, jitter):
    (guess,) = CLOCK.guesses(heard(1, pace, period, jitter, error=2e-4))
    assert guess["period_s"] == pytest.approx(period, rel=2e-5)
