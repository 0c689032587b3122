"""Ideal and Gaussian sonars, compiled: `noise.model.IdealModel` and `noise.model.GaussianModel`."""

from __future__ import annotations

import math

import numpy as np

from acquisition.arrays import Bytes, Floats
from noise.law import CREDENCE_TOLERANCE
from noise.model import GaussianModel, IdealModel
from sonar_gym.compiled import compiled
from sonar_gym.sensing.laws.drawn import PathDraws, PathLaw, PathPings, PathSource
from sonar_gym.sensing.laws.numbers import normal_cdf, normal_quantile


@compiled
def to_step(range_: float, resolution: float, last_step: int) -> float:
    """Return the step of the register nearest to a range in m."""
    return min(max(math.ceil(range_ / resolution - 0.5), 1.0), last_step)


@compiled
def within(low: float, high: float, mean: float, sigma: float) -> float:
    """Return P(low < reading <= high)."""
    if sigma > 0.0:
        return normal_cdf((high - mean) / sigma) - normal_cdf((low - mean) / sigma)
    return 1.0 if low < mean <= high else 0.0


@compiled
def credence_of(distance: float, sigma: float, resolution: float, last_step: int) -> float:
    """Return P(the step of the register is within 10 % of the distance), given an echo."""
    low = math.ceil((1.0 - CREDENCE_TOLERANCE) * distance / resolution - 1e-9)
    high = math.floor((1.0 + CREDENCE_TOLERANCE) * distance / resolution + 1e-9)
    if sigma == 0.0:
        return 1.0 if low <= to_step(distance, resolution, last_step) <= high else 0.0
    least = -math.inf if low <= 1.0 else (low - 0.5) * resolution
    most = math.inf if high >= last_step else (high + 0.5) * resolution
    return within(least, most, distance, sigma) if high >= 1.0 else 0.0


@compiled
def draw_normal(
    distance: Floats, uniform: Floats, sigma: float, per_metre: float, miss: float, resolution: float,
    max_range: float, limit: float,
) -> tuple[Floats, Bytes, Floats]:  # fmt: skip
    """Return ranges, m, statuses and credences given the condition of m pings.

    Args:
        distance: true distances, m, (m,).
        uniform: random numbers, (m,); unused by a sonar that always reads the true distance, whose may be empty.
        sigma: standard deviation at zero distance, m.
        per_metre: its growth with distance, m per m.
        miss: probability of no echo.
        resolution: step of the register, m.
        max_range: range beyond which the model gives no echo, m.
        limit: range beyond which an echo is none, m.
    """
    n, last_step = distance.shape[0], max(1, round(max_range / resolution))
    reading, status, credence = np.zeros(n), np.zeros(n, np.uint8), np.zeros(n)
    for i in range(n):
        missed, spread = 1.0 if distance[i] > max_range else miss, sigma + per_metre * distance[i]
        credence[i] = (1.0 - missed) * credence_of(distance[i], spread, resolution, last_step)
        u = uniform[i] if uniform.shape[0] else 0.5
        if missed >= 1.0 or u >= 1.0 - missed:
            continue
        share = min(max(u / (1.0 - missed), 1e-300), 1.0 - 1e-16)
        place = distance[i] + spread * normal_quantile(share) if spread > 0.0 else distance[i]
        value = to_step(place, resolution, last_step) * resolution
        if value <= limit:
            reading[i], status[i] = value, 1
    return reading, status, credence


class Normal(PathLaw):
    """The law of an ideal or Gaussian sonar.

    Args:
        model: the model; an ideal one takes no random numbers.
        max_range: range beyond which an echo is none, m.
    """

    def __init__(self, model: IdealModel | GaussianModel, max_range: float) -> None:
        self._random = isinstance(model, GaussianModel)
        spread = (model.sigma, model.sigma_per_metre, model.miss) if isinstance(model, GaussianModel) else (0.0,) * 3
        self._numbers = *spread, model.resolution, model.max_range, max_range

    def draw(self, pings: PathPings, source: PathSource) -> PathDraws:
        """Draw the readings of m pings."""
        distance = pings.conditions[0]
        uniform = source.random(len(distance)) if self._random else distance[:0]
        return PathDraws(*draw_normal(distance, uniform, *self._numbers), None)
