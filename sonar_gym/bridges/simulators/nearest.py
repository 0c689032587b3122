"""The sonar nearest to a model that a simulator itself can hold, and the error that it leaves.

Both simulators hold normal noise and no losses: Webots by a table over distance, Gazebo with one bias and one standard
deviation for all. The nearest law has the least mean CRPS against the model's readings in conditions of the field,
where no echo counts as the maximum range, as both simulators return it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtr

from acquisition import Ping, Reading, SettingError
from acquisition.arguments import checked
from acquisition.arrays import Bits, Floats
from noise import ConditionPrior, SonarModel
from noise.metrics import crps_with_silence
from noise.table import TableModel

N_NODES = 25  # distances of a table
DRAWS = 20  # readings per condition
NEAR_M = 0.05  # nearest distance of a table
MIN_SIGMA = 1e-4  # m
FIT, SCORE = 0, 1  # streams of random numbers
FEW = 5  # readings of which one normal law is fitted at the least


@dataclass(frozen=True)
class Nearest:
    """A law that a simulator can hold.

    Attributes:
        table: the law.
        crps_mm: mean CRPS of the law against readings of the model, mm.
        model_crps_mm: mean CRPS of the model itself against the same readings, mm: the least that is possible.
        silent: share of the readings without an echo, which the simulator cannot hold.
    """

    table: TableModel
    crps_mm: float
    model_crps_mm: float
    silent: float

    @property
    def left_mm(self) -> float:
        """The error that the simulator's law leaves, mm CRPS."""
        return self.crps_mm - self.model_crps_mm


@dataclass(frozen=True)
class Field:
    """Conditions of the field and readings of a model there.

    Attributes:
        ping: conditions, (n,).
        reading: readings, (n,).
        value: readings, m, with the maximum range for no echo, (n,).
        max_range: maximum range, m.
    """

    ping: Ping
    reading: Reading
    value: Floats
    max_range: float

    @classmethod
    def of(cls, model: SonarModel, max_range: float, seed: int, stream: int) -> Field:
        """Draw `DRAWS` readings of a model in each condition of the broad prior up to a maximum range, m."""
        grid = ConditionPrior(near=NEAR_M, far=max_range, distances=N_NODES).grid()[0]
        ping = grid[np.tile(np.arange(len(grid)), DRAWS)]
        drawn = model.law(ping).sample(np.random.default_rng([seed, stream]))
        near = drawn.echo & (drawn.range < max_range)
        value = np.where(near, drawn.range, max_range)
        return cls(ping, Reading.of(np.where(near, drawn.range, 0.0)), value, max_range)

    def score(self, model: SonarModel) -> float:
        """Return the mean CRPS of a model against the readings, mm."""
        return 1000.0 * float(crps_with_silence(model.law(self.ping), self.reading, self.max_range).mean())


def normal_crps(mean: float | Floats, sigma: float, value: Floats) -> Floats:
    """Return the CRPS of normal laws, m, (n,); Gneiting and Raftery (2007), equation 21.

    >>> float(normal_crps(0.0, 1.0, np.array([0.0]))[0].round(4))
    0.2337
    """
    z = (value - mean) / sigma
    density = np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
    crps: Floats = sigma * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / np.sqrt(np.pi))
    return crps


def fit_normal(value: Floats, offset: Floats | float = 0.0) -> tuple[float, float]:
    """Return mean and standard deviation of the normal law with the least mean CRPS, m.

    Args:
        value: readings, m, (n,).
        offset: added to the mean for each reading, m, (n,).
    """

    def sigma_of(x: Floats) -> float:
        return max(float(np.exp(x[1])), MIN_SIGMA)

    def cost(x: Floats) -> float:
        return float(normal_crps(x[0] + offset, sigma_of(x), value).mean())

    start: Floats = np.array([np.median(value - offset), np.log(max(float(np.std(value - offset)), MIN_SIGMA))])
    found = minimize(cost, list(start), method="Nelder-Mead")
    return float(found.x[0]), sigma_of(found.x)


@checked
def nearest_table(model: SonarModel, max_range: float, max_incidence: float, seed: int = 0) -> Nearest:
    """Return the nearest table over distance.

    Args:
        model: the model.
        max_range: maximum range, m.
        max_incidence: incidence beyond which the simulator's sonar returns the maximum range, rad.
        seed: of the readings drawn.
    """
    field = _field(model, max_range, seed, FIT)
    inside = np.abs(field.ping.incidence) <= max_incidence
    nodes = np.unique(field.ping.distance)
    rows = [_fit_at(field, inside & (field.ping.distance == node)) for node in nodes]
    means, sigmas = zip(*rows, strict=True)
    table = TableModel(tuple(map(float, nodes)), means, sigmas, max_range, max_incidence)
    return _nearest(model, table, max_range, seed)


def _fit_at(field: Field, rows: Bits) -> tuple[float, float]:
    return fit_normal(field.value[rows]) if rows.sum() >= FEW else (field.max_range, MIN_SIGMA)


@checked
def nearest_gaussian(model: SonarModel, max_range: float, seed: int = 0) -> Nearest:
    """Return the nearest law with one bias and one standard deviation for all distances; see `nearest_table`."""
    field = _field(model, max_range, seed, FIT)
    bias, sigma = fit_normal(field.value, field.ping.distance)
    ends = (0.0, max_range)
    table = TableModel(ends, (bias, max_range + bias), (sigma, sigma), max_range)
    return _nearest(model, table, max_range, seed)


def _field(model: SonarModel, max_range: float, seed: int, stream: int) -> Field:
    if not 0.1 <= max_range <= 20.0:
        raise SettingError(f"max_range must lie in [0.1, 20] m, got {max_range:g} m")
    if not model.law(Ping.of(1.0)).has_probabilities:
        raise SettingError(
            "export: the model can only be sampled; train a law on its readings (`sonar-gym train-noise`)"
        )
    return Field.of(model, max_range, seed, stream)


def _nearest(model: SonarModel, table: TableModel, max_range: float, seed: int) -> Nearest:
    """Score a table on readings that it was not fitted to."""
    field = _field(model, max_range, seed, SCORE)
    silent = float(np.mean(~field.reading.echo))
    return Nearest(table, field.score(table), field.score(model), silent)
