"""How likely a model is to detect a reflector, tabulated over the conditions of a ping.

The table decides which of the reflectors in a cone are given to the model, so that faces that no sonar would hear cost
no evaluation of a law. The probabilities of the readings themselves always come from the law.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from functools import lru_cache
from typing import Any, cast

import numpy as np

from acquisition import Ping, Reading
from acquisition.arrays import Bits, Floats
from noise import SonarModel, listener
from sonar_gym.compiled import compiled

SHAPE = (24, 17, 18, 6)  # nodes of distance, bearing, incidence, root of reflectance
SAMPLED_SHAPE = (12, 7, 9, 4)  # for a model that can only be sampled, which takes long
# Farthest echo of another burst, m: the useful range of an SRF08 is 6 m (Devantech), and the surveys of the learned
# laws end there; of a mirror 8 m away the rig receives one echo in ten, 9.5 m away none
LISTENING_M = 6.5
LISTENING_NODES = 52, 2  # of distance and incidence up to there; other bursts are given to a law at normal incidence
MAX_BEARING = np.radians(60.0)
MAX_INCIDENCE = np.radians(85.0)  # greatest in the survey of the learned laws
NEAREST = 0.01  # nearest node relative to the farthest
BEAM_CONTRAST = 0.01  # difference of probabilities that a beam makes at the least
SEED = 2016  # of the draws from a law without probabilities
# An echo of the reflector itself is read within 1 % (air 6 K warmer or colder) and 0.07 m (the rise of the burst, which
# a weak echo takes to cross the threshold); echoes of what stands behind it come later. As 1 and m.
OWN_ECHO = (0.01, 0.07)


def detection_table(model: SonarModel, far: float) -> Floats:
    """Return the probabilities that a reflector alone in the cone returns an echo of its own, in four dimensions.

    The nodes are uniform: distances up to `far` m, bearings within +-`MAX_BEARING`, incidences up to `MAX_INCIDENCE`,
    square roots of reflectances from 0 to 1, which are denser where detection changes most. The table is computed once
    per model and distance.
    """
    return _detection_table(cast(Hashable, model), far)


def listening_table(model: SonarModel) -> Floats:
    """Return the probabilities of `detection_table` for distances up to `LISTENING_M`, coarse in incidence."""
    return _detection_table(cast(Hashable, model), LISTENING_M, *LISTENING_NODES)


@lru_cache(maxsize=16)
def _detection_table(model: Any, far: float, distances: int = 0, incidences: int = 0) -> Floats:
    shape = SHAPE if listener(model).law(Ping.of(1.0)).has_probabilities else SAMPLED_SHAPE
    if distances:
        shape = distances * shape[0] // SHAPE[0], shape[1], incidences, shape[3]
    return _own_echo(model, nodes(far, shape)).reshape(shape)


def nodes(far: float, shape: tuple[int, ...]) -> Ping:
    """Return the nodes of a table as pings, up to a distance of `far` m."""
    axes = (NEAREST * far, far), (-MAX_BEARING, MAX_BEARING), (0.0, MAX_INCIDENCE), (0.0, 1.0)
    grid = np.meshgrid(*(np.linspace(*ends, n) for ends, n in zip(axes, shape, strict=True)), indexing="ij")
    distance, bearing, incidence, root = (axis.ravel() for axis in grid)
    return Ping.of(distance, bearing, incidence, root**2, time=0.0, run=np.arange(distance.size))


def has_beam(table: Floats) -> bool:
    """Return whether a model detects less at greater bearings; one that does not has no beam, and no cross-talk."""
    return bool(np.any(np.ptp(table, axis=1) > BEAM_CONTRAST))


def own_window(distance: Floats) -> Floats:
    """Return the largest deviation from a reflector's distance of an echo that is taken for its own, m, (n,)."""
    return OWN_ECHO[0] * distance + OWN_ECHO[1]


def is_own_echo(distance: Floats, reading: Reading) -> Bits:
    """Return whether each reading is an echo of a reflector at the given distance, (n,)."""
    return reading.echo & (np.abs(reading.range - distance) <= own_window(distance))


def _own_echo(model: SonarModel, ping: Ping) -> Floats:
    """Return P(own echo), (n,), or one draw per ping where a law has no probabilities."""
    law = listener(model).law(ping)
    if not law.has_probabilities:
        return is_own_echo(ping.distance, law.sample(np.random.default_rng(SEED))).astype(np.float64)
    width = own_window(ping.distance)
    return law.arrival(ping.distance + width) - law.arrival(ping.distance - width)


@compiled
def node_below(value: float, low: float, high: float, count: int) -> tuple[int, float]:
    """Return the node below a value among `count` uniform nodes, and the distance from it relative to their spacing."""
    place = min(max((value - low) / (high - low) * (count - 1), 0.0), count - 1.0)
    node = min(int(place), count - 2)
    return node, place - node


@compiled
def detection(
    table: Floats, far: float, distance: float, bearing: float, incidence: float, reflectance: float
) -> float:
    """Return the probability that a reflector alone in the cone returns an echo of its own, by interpolation."""
    i, a = node_below(distance, NEAREST * far, far, table.shape[0])
    j, b = node_below(bearing, -MAX_BEARING, MAX_BEARING, table.shape[1])
    k, c = node_below(incidence, 0.0, MAX_INCIDENCE, table.shape[2])
    m, d = node_below(math.sqrt(reflectance), 0.0, 1.0, table.shape[3])
    total = 0.0
    for p in range(2):
        for q in range(2):
            x, y = i + p, j + q
            low = table[x, y, k, m] + d * (table[x, y, k, m + 1] - table[x, y, k, m])
            high = table[x, y, k + 1, m] + d * (table[x, y, k + 1, m + 1] - table[x, y, k + 1, m])
            weight = (a if p else 1.0 - a) * (b if q else 1.0 - b)
            total += weight * (low + c * (high - low))
    return total
