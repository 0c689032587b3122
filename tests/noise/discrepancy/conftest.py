"""Logs of a robot that wanders to and fro in front of a wall, and pairs of files."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import ndtr

from acquisition import Ping, Reading, Recording
from noise.fitting.stack import Stack
from noise.fitting.visit_effects import placement_scatter
from tests.noise.discrepancy.pairs import ROUGH, TRUTH, model, pair, record, survey

PACE_S = 0.1


def wandering(rng, n, pings=50):
    """Return a smooth course that is uniform on [0, 1] in the long run, and forgets in so many pings, (n,)."""
    x, keep = rng.normal(size=n + 10), np.exp(-1.0 / pings)
    for k in range(1, len(x)):
        x[k] = keep * x[k - 1] + np.sqrt(1.0 - keep**2) * x[k]
    return ndtr(np.convolve(x, np.full(10, 0.1), "valid")[:n])


def way(rng, n):
    """Return where a wall is while a robot wanders between 0.3 and 3.5 m of it, (n,)."""
    return 0.3 + 3.2 * wandering(rng, n)


def turning(rng, n):
    """Return at which angle the wall stands meanwhile, rad, (n,)."""
    return 1.2 * (wandering(rng, n) - 0.5)


def log_of(reading, **ping):
    """Return readings, m, 0 for silence, as a log to the tenth of a millimetre."""
    time = np.arange(len(reading)) * PACE_S
    return Recording.of(Ping.of(time=time, **ping), Reading.of(np.round(np.maximum(reading, 0.0), 4)))


@pytest.fixture(scope="session")
def robot():
    """Where a robot is, at which angle, its logs, and its pace."""
    return SimpleNamespace(way=way, turning=turning, log_of=log_of, pace_s=PACE_S)


@pytest.fixture(scope="session")
def lab():
    """The maker of pairs, the rough law, and the parts that they are made of."""
    rough = Stack.of(model(ROUGH)).put([("visits", "placement_m")], [0.003])
    exact = Stack.of(model(TRUTH)).put([("visits", "placement_m")], [0.003 / placement_scatter(1.0)])
    return SimpleNamespace(pair=pair, survey=survey, record=record, model=model, rough=rough, exact=exact, truth=TRUTH)
