"""`noise.learned.networks.MlpModel`, compiled; the features are those of `noise.learned.inputs`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from acquisition.arrays import Bytes, Floats, Ints, Singles
from noise.learned.gain import LOSS
from noise.learned.inputs import LOG_OFFSET_M, Inputs
from noise.learned.networks import MlpModel
from sonar_gym.compiled import compiled
from sonar_gym.sensing.laws import mixture
from sonar_gym.sensing.laws.dense import BLOCK, network, packed
from sonar_gym.sensing.laws.drawn import PathDraws, PathLaw, PathPings, PathSource
from sonar_gym.sensing.laws.mixture import MAX_COMPONENTS, Shape

CONDITIONS = ("distance", "angle", "incidence", "reflectance")
APART = 0.5  # rad; incidence this much apart from bearing counts as one span outside conditions where both are equal


class Features(NamedTuple):
    """The features of `Inputs` as numbers.

    Attributes:
        columns: row of each quantity in the conditions of pings, covariates after `CONDITIONS`, (q,).
        low, high, span: learned ranges of the quantities, (q,).
        log: logarithm of the least distance and the scale of logarithms.
        covariates: number of covariates.
        default: value of each quantity where it is not given; NaN for none, (q,).
        folded, tied, open_end: see `Inputs`.
    """

    columns: Ints
    low: Floats
    high: Floats
    span: Floats
    log: tuple[float, float]
    covariates: int
    default: Floats
    folded: bool
    tied: bool
    open_end: bool

    @classmethod
    def of(cls, inputs: Inputs) -> Features:
        """Return the numbers of inputs."""
        known = (*CONDITIONS, *inputs.covariates)
        columns = [known.index(name) for name in inputs.names]
        low, high, span = inputs.ranges
        near, far = math.log(low[0] + LOG_OFFSET_M), math.log(high[0] + LOG_OFFSET_M)
        log = near, 2.0 / max(far - near, 0.1)
        flags = inputs.folded, inputs.tied, inputs.open_end
        default = np.where(np.array(inputs.names) == LOSS, 0.0, np.nan)
        return cls(np.array(columns), low, high, span, log, len(inputs.covariates), default, *flags)


@compiled
def write_features(f: Features, pings: Floats, i: int, x: Singles, r: int) -> float:
    """Write the features of ping i into column r of a block; return its distance from the learned conditions.

    A covariate without a row, or with NaN, has its default, or is missing.
    """
    excess, quantities, own = 0.0, f.columns.shape[0], len(CONDITIONS)
    for k in range(quantities):
        column = f.columns[k]
        value = pings[column, i] if column < pings.shape[0] else math.nan
        value = f.default[k] if math.isnan(value) else value
        if column >= own:
            x[quantities + 1 + column - own, r] = -1.0 if math.isnan(value) else 1.0
        if math.isnan(value):
            x[k, r] = 0.0
            continue
        if f.folded and (column == 1 or column == 2):
            value = abs(value)
        inside = min(max(value, f.low[k]), f.high[k])
        x[k, r] = (inside - f.low[k]) * 2.0 / f.span[k] - 1.0
        if k == 0:
            x[quantities, r] = f.log[1] * (math.log(inside + LOG_OFFSET_M) - f.log[0]) - 1.0
        if not (k == 0 and f.open_end and value > f.high[0]):
            excess = max(excess, abs(value - inside) / f.span[k])
    apart = abs(abs(pings[2, i]) - abs(pings[1, i]))
    return max(excess, apart / APART) if f.tied and apart > 1e-9 else excess


@compiled
def draw_perceptron(
    f: Features, weights: Singles, sizes: Ints, shape: Shape, max_range: float, pings: Floats, uniform: Floats
) -> tuple[Floats, Bytes, Floats]:
    """Return ranges, m, statuses and credences given the condition of m pings.

    Args:
        f: features.
        weights: weights and biases of all layers.
        sizes: widths of all layers.
        shape: meaning of the outputs.
        max_range: range beyond which an echo is none, m.
        pings: conditions, (4, m).
        uniform: random numbers, (2, m).
    """
    n, rows = pings.shape[1], sizes.max()
    reading, status, credence = np.empty(n), np.empty(n, np.uint8), np.empty(n)
    x, y = np.zeros((rows, BLOCK), np.float32), np.zeros((rows, BLOCK), np.float32)
    excess, share = np.empty(BLOCK), np.empty(MAX_COMPONENTS + 2)
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        for r in range(size):
            excess[r] = write_features(f, pings, start + r, x, r)
        out = network(weights, sizes, x, y)
        for r in range(size):
            i = start + r
            reading[i], status[i], credence[i] = mixture.draw(
                out, r, shape, pings[0, i], excess[r], (0.0, 0.0), (uniform[0, i], uniform[1, i]), share
            )
            if reading[i] > max_range:
                reading[i], status[i] = 0.0, mixture.NO_ECHO
    return reading, status, credence


class Perceptron(PathLaw):
    """The law of single pings of an `MlpModel`.

    Args:
        model: the model; covariates that the pings lack are missing.
        max_range: range beyond which an echo is none, m.
    """

    def __init__(self, model: MlpModel, max_range: float) -> None:
        self._max_range = max_range
        self._features, self._shape = Features.of(model.inputs), Shape.of(model.head)
        self._weights, self._sizes = packed(model.layers)

    def draw(self, pings: PathPings, source: PathSource) -> PathDraws:
        """Draw the readings of m pings."""
        uniform = source.random((2, pings.conditions.shape[1]))
        law = self._features, self._weights, self._sizes, self._shape, self._max_range
        return PathDraws(*draw_perceptron(*law, pings.conditions, uniform), None)
