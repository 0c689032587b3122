"""Readings of a simulation, or of a recording, as a law: a quantile regression forest between its own conditions.

A ping has the errors of the readings that were made under conditions like its own (`Similarity`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from acquisition import ModelError, Ping, Reading
from acquisition.arrays import Bits, Floats, Ints
from acquisition.brief import brief
from noise.discrepancy.baseline.forest_law import N_LEVELS, QuantileLaw, quantiles
from noise.discrepancy.baseline.similarity import Similarity, similarity
from noise.discrepancy.baseline.trees import input_groups, outcomes
from noise.discrepancy.moments.sample import places
from noise.fitting.batch import Batch
from noise.fitting.visit_effects import FLOOR
from noise.law import EchoLaw
from noise.metrics import crps_with_silence
from noise.model import MAX_RANGE, SonarModel

MAX_PINGS = 4000  # of the forest, thinned by visit; bounds time and the size of the file


@dataclass(frozen=True, eq=False)
class AnalogueForest:
    """A sonar that reads what it read under similar conditions and after a similar past, at the same errors.

    Attributes:
        similar: which stored readings are like a ping's, m of them.
        error: of each stored reading, m, ascending, infinite for no echo, (m,).
        resolution, max_range: of the register, m.
    """

    __repr__ = brief

    similar: Similarity
    error: Floats
    resolution: float
    max_range: float

    @classmethod
    def of(cls, batch: Batch, rng: np.random.Generator, max_range: float = MAX_RANGE) -> AnalogueForest:
        """Return the law of readings, with the inputs that predict visits which trees have not seen.

        Args:
            batch: readings.
            rng: grows the trees.
            max_range: of the register's last step, m.
        """
        return _best(batch, rng, max_range)[0]

    @property
    def remembers(self) -> bool:
        """Whether the previous reading is an input."""
        return self.similar.remembers

    def law(self, ping: Ping, past: Reading | None = None) -> QuantileLaw:
        """Return the law of n pings, given the previous reading of each; a ping alone is the first of its visit."""
        return self.mixture(ping, self.similar.reached(ping, past))

    def mixture(
        self, ping: Ping, reached: Ints, used: Bits | None = None, places: tuple[Ints, Ints] | None = None
    ) -> QuantileLaw:
        """Return the law of n pings.

        Args:
            ping: pings.
            reached: their leaves, (n, t).
            used: trees that are asked for each, (n, t); every tree by default.
            places: of the pings, (n,), and of the stored readings, (m,): those in its own place are left out.
        """
        n, n_echo = len(ping), int(np.isfinite(self.error).sum())
        p_echo, centre = np.empty(n), np.empty((n, N_LEVELS))
        for rows, each in self.similar.weights(reached, used):
            every = each if places is None else _elsewhere(each, places[0][rows], places[1])
            weight = every[:, :n_echo]
            p_echo[rows] = weight.sum(axis=1)
            centre[rows] = quantiles(weight, self.error[:n_echo])
        knots = np.maximum(ping.distance[:, None] + centre, self.resolution)
        return QuantileLaw(ping.distance, np.minimum(p_echo, 1.0), knots, self.resolution, self.max_range)

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data; errors of readings without an echo are null."""
        error = [x if np.isfinite(x) else None for x in self.error.tolist()]
        base = {"kind": "forest", "resolution": self.resolution, "max_range": self.max_range}
        return {**base, **self.similar.to_dict(), "error": error}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> AnalogueForest:
        """Return the model that `to_dict` describes.

        Raises:
            ModelError: a part is missing or does not fit the others.
        """
        try:
            error = np.array([np.inf if x is None else float(x) for x in data["error"]])
            similar, limits = Similarity.from_dict(data), (float(data["resolution"]), float(data["max_range"]))
            if error.shape != (len(similar.leaf),):
                raise ValueError("its readings and leaves differ in number")
            falls = (np.diff(error[np.isfinite(error)]) < 0).any()
            if not np.isfinite(limits).all() or min(limits) <= 0.0 or np.isnan(error).any() or falls:
                raise ValueError("its register or its errors are not valid")
        except (KeyError, TypeError, ValueError) as problem:
            raise ModelError(f"model: cannot be built from its parts ({problem}); it may be damaged") from None
        return cls(similar, error, *limits)


def _elsewhere(weight: csr_array, place: Ints, stored: Ints) -> csr_array:
    """Return weights, (k, m), without those of readings in the place of each ping; as they are where there are none."""
    row = np.repeat(np.arange(len(place)), np.diff(weight.indptr))
    value = np.where(stored[weight.indices] == place[row], 0.0, weight.data)
    left = np.bincount(row, value, len(place))
    value = np.divide(value, left[row], out=weight.data.copy(), where=left[row] > 0.0)
    return csr_array((value, weight.indices, weight.indptr), shape=weight.shape)


def errors(batch: Batch) -> Floats:
    """Return the error of each reading, m, (n,); infinite for no echo."""
    return np.where(batch.reading.echo, batch.error, np.inf)


@dataclass(frozen=True, eq=False)
class Elsewhere:
    """A forest that predicts a ping without the readings that were made in the ping's own place.

    Where a recording has the places of a simulation, that tells what a forest of the simulation is worth in others.

    Attributes:
        forest: the forest.
        place: of its readings, (m, 4).
    """

    forest: AnalogueForest
    place: Floats

    __repr__ = brief

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.forest.resolution

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading."""
        return self.forest.remembers

    def law(self, ping: Ping, past: Reading | None = None) -> QuantileLaw:
        """Return the law of n pings, given the previous reading of each."""
        every = np.unique(np.concatenate([places(ping), self.place]), axis=0, return_inverse=True)[1].ravel()
        both = every[: len(ping)], every[len(ping) :]
        return self.forest.mixture(ping, self.forest.similar.reached(ping, past), places=both)


@dataclass(frozen=True, eq=False)
class Grown:
    """A model with a forest, its readings, and their law by the trees that were grown without their visits."""

    model: SonarModel
    batch: Batch
    crossed: EchoLaw

    def of_others(self, batch: Batch) -> AnalogueForest:
        """Return a forest with the same trees and other readings of the same pings."""
        assert isinstance(self.model, AnalogueForest)
        rank = np.argsort(errors(self.batch), kind="stable")  # in which the forest holds the readings
        error = errors(batch)[rank]
        order = np.argsort(error, kind="stable")
        return replace(self.model, similar=self.model.similar.ordered(order), error=error[order])

    def elsewhere(self) -> Elsewhere:
        """Return the forest as it is for places that it has not seen."""
        assert isinstance(self.model, AnalogueForest)
        place = places(self.batch.ping)[np.argsort(errors(self.batch), kind="stable")]
        return Elsewhere(self.model, place)

    @cached_property
    def crps(self) -> Floats:
        """CRPS of each reading, silence counted, by trees that saw no ping of its visit, m, (n,)."""
        return self.crps_within(None)

    def crps_within(self, tolerance: float | None) -> Floats:
        """Return the same with a tolerance, m, (n,); see `crps_with_silence`."""
        return np.asarray(crps_with_silence(self.crossed, self.batch.reading, MAX_RANGE, tolerance=tolerance))

    @cached_property
    def nats(self) -> Floats:
        """Log probability of each reading by trees that saw no ping of its visit, nats, (n,), with a floor."""
        return floored_log_prob(self.crossed, self.batch)


def _grown(
    batch: Batch, names: tuple[str, ...], rng: np.random.Generator, max_range: float
) -> tuple[AnalogueForest, Grown]:
    similar, reached, unseen = similarity(batch, names, outcomes(batch), rng)
    error = errors(batch)
    order = np.argsort(error, kind="stable")
    model = AnalogueForest(similar.ordered(order), error[order], batch.resolution, max_range)
    return model, Grown(model, batch, model.mixture(batch.ping, reached, unseen))


def _best(batch: Batch, rng: np.random.Generator, max_range: float) -> tuple[AnalogueForest, Grown]:
    few = batch.thin(MAX_PINGS)
    pairs = (_grown(few, names, rng, max_range) for names in input_groups(few))
    return min(pairs, key=lambda pair: pair[1].crps.mean())


def grown(batch: Batch, rng: np.random.Generator, max_range: float = MAX_RANGE) -> Grown:
    """Return the forest of at most `MAX_PINGS` readings with the inputs that predict visits best which trees lack."""
    return _best(batch, rng, max_range)[1]


def floored_log_prob(law: EchoLaw, batch: Batch) -> Floats:
    """Return the log probability of each reading, nats, (n,), with a floor for what a law calls impossible.

    The steps of the law are put where those of the readings are.
    """
    law.origin = batch.origin
    steps = max(law.last_step, 1)
    coarser = np.log(steps * batch.resolution / law.max_range) if batch.reading.echo.any() else 0.0
    nats = law.log_prob(batch.reading) + np.where(batch.reading.echo, min(coarser, 0.0), 0.0)
    floor = np.where(batch.reading.echo, FLOOR / steps, FLOOR)
    return np.log((1.0 - 2.0 * FLOOR) * np.exp(nats) + floor)
