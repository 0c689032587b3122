"""What a recording shows beyond a law, without a name: the law is recalibrated locally.

The probability integral transform (PIT) of a reading z under a law F is u = F(z), with no echo as the greatest value.
If the law is right, u is uniform under all conditions. A forest of the recording's own transforms gives their
distribution G under conditions like those of a ping, after a like past and at a like time, and G(F(z)) is the
recalibrated law (Cal-PIT: Dey et al. 2022, arXiv 2205.14568). Offset, spread, skew and detection are corrected
together, relative to the law: as it says how readings change with conditions, so does the recalibrated one.

An echo where the law expects next to none has no place in it. Its error is kept, as in `AnalogueForest`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtri

from acquisition import ModelError, Ping, Reading
from acquisition.arrays import Bits, Floats, Ints
from acquisition.brief import brief
from noise.discrepancy.baseline.forest import MAX_PINGS, Grown
from noise.discrepancy.baseline.forest_law import LEVELS, N_LEVELS, QuantileLaw, quantiles
from noise.discrepancy.baseline.similarity import Similarity, similarity
from noise.discrepancy.baseline.trees import MEAN_ABS_NORMAL, input_groups, standardised
from noise.fitting.batch import Batch
from noise.law import EchoLaw
from noise.metrics import crps_with_silence
from noise.model import MAX_RANGE, SonarModel

UNEXPECTED = 0.005  # share of a law's echoes at each end among which a reading is no part of the law; chosen here
RARE = 1e-12  # smallest divisor


class RecalibratedLaw(EchoLaw):
    """A law pooled with its recalibration.

    Attributes:
        law: of n pings.
        place: probability of a transform up to each of `LEVELS`, (n, `N_LEVELS`).
        unexpected: echoes that are no part of the law, with their probability.
        share: of the recalibration in the pool, 0 to 1.
    """

    uniform_per_ping = True

    def __init__(self, law: EchoLaw, place: Floats, unexpected: QuantileLaw, share: float) -> None:
        super().__init__(law.distance, law.resolution, law.max_range)
        self.law, self.place, self.unexpected, self.share = law, place, unexpected, share
        self._answer = 1.0 - law.no_answer

    def _arrival(self, z: Floats) -> Floats:
        own = self.law._arrival(z)
        if self.share == 0.0:
            return own
        u = np.clip(np.divide(own, self._answer, out=np.zeros_like(own), where=self._answer > 0.0), 0.0, 1.0)
        at = np.clip(np.searchsorted(LEVELS, u, side="right"), 1, N_LEVELS - 1)
        row = np.broadcast_to(np.arange(len(self)), u.shape)
        low, high = self.place[row, at - 1], self.place[row, at]
        within = low + (u - LEVELS[at - 1]) / (LEVELS[at] - LEVELS[at - 1]) * (high - low)
        moved = self._answer * np.minimum(within + self.unexpected._arrival(z), 1.0)
        return (1.0 - self.share) * own + self.share * moved

    def pooled(self, share: float) -> RecalibratedLaw:
        """Return the same with another share of the recalibration."""
        return RecalibratedLaw(self.law, self.place, self.unexpected, share)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        return self.law.no_answer


@dataclass(frozen=True, eq=False)
class Recalibrated:
    """A model recalibrated by a recording.

    Attributes:
        model: the model.
        similar: which readings of the recording are like a ping's, m of them.
        low, high: transform at the lower and upper end of the step of each reading, or of its silence, (m,).
        error: of the readings that are no part of the model's law, m, ascending; they are the first, (k,).
        share: of the recalibration in the pool with the model's own law, 0 to 1.
    """

    __repr__ = brief

    model: SonarModel
    similar: Similarity
    low: Floats
    high: Floats
    error: Floats
    share: float

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading."""
        return self.model.remembers or self.similar.remembers

    def law(self, ping: Ping, past: Reading | None = None) -> RecalibratedLaw:
        """Return the law of n pings, given the previous reading of each."""
        return self.mixture(self.model.law(ping, past), ping, self.similar.reached(ping, past))

    def mixture(self, law: EchoLaw, ping: Ping, reached: Ints, used: Bits | None = None) -> RecalibratedLaw:
        """Return a recalibrated law of n pings with given leaves, (n, t), and trees, (n, t)."""
        n, k = len(ping), len(self.error)
        place, p_echo, centre = np.empty((n, N_LEVELS)), np.empty(n), np.empty((n, N_LEVELS))
        for rows, weight in self.similar.weights(reached, used):
            place[rows] = weight[:, k:] @ self._places
            p_echo[rows] = weight[:, :k].sum(axis=1)
            centre[rows] = quantiles(weight[:, :k], self.error)
        knots = np.maximum(ping.distance[:, None] + centre, law.resolution)
        return RecalibratedLaw(law, place, QuantileLaw(ping, p_echo, knots, law.resolution, law.max_range), self.share)

    @cached_property
    def _places(self) -> Floats:
        """Distribution function of the transform of each reading that is part of the law, (m - k, `N_LEVELS`)."""
        low, high = (each[len(self.error) :, None] for each in (self.low, self.high))
        return np.clip((LEVELS - low) / np.maximum(high - low, np.finfo(float).tiny), 0.0, 1.0)

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data.

        Raises:
            ModelError: the inner model cannot be saved.
        """
        inner: Any = self.model
        if not hasattr(inner, "to_dict"):
            raise ModelError(f"Recalibrated: a {type(inner).__name__} cannot be saved; it has no to_dict()")
        numbers = {name: getattr(self, name).tolist() for name in ("low", "high", "error")}
        return {
            "kind": "recalibrated",
            "model": inner.to_dict(),
            **self.similar.to_dict(),
            **numbers,
            "share": self.share,
        }

    @classmethod
    def load(cls, folder: Any, data: dict[str, Any], load_kind: Any) -> Recalibrated:
        """Load a saved model; `load_kind` loads the inner model.

        Raises:
            ModelError: a part is missing or does not fit the others.
        """
        try:
            low, high, error = (np.asarray(data[name], dtype=np.float64) for name in ("low", "high", "error"))
            similar, share = Similarity.from_dict(data), float(data["share"])
            if not len(low) == len(high) == len(similar.leaf) >= len(error):
                raise ValueError("its readings and leaves differ in number")
            ordered = (low <= high).all() and not (np.diff(error) < 0).any()
            if not (ordered and np.isfinite(np.r_[low, high, error]).all() and 0.0 <= share <= 1.0):
                raise ValueError("its transforms, errors or share are not valid")
        except (KeyError, TypeError, ValueError) as problem:
            raise ModelError(f"model: cannot be built from its parts ({problem}); it may be damaged") from None
        return cls(load_kind(folder, data["model"]), similar, low, high, error, share)


def recalibrated(model: SonarModel, batch: Batch, rng: np.random.Generator) -> Grown | None:
    """Return a model recalibrated by readings; None where that does not predict visits better that trees lack.

    The inputs, and the share in the pool with the model, are those of the least CRPS on such visits. The CRPS of a pool
    of two laws is quadratic in their share, so that three values give its minimum.

    Args:
        model: the model.
        batch: readings; at most `MAX_PINGS` are used, thinned by visit.
        rng: grows the trees.
    """
    few = batch.thin(MAX_PINGS)
    law = model.law(few.ping, few.past)
    law.origin = few.origin
    every = [_recalibrated(model, law, few, names, rng) for names in input_groups(few)]
    none = _mean_crps(every[0][1].pooled(0.0), few)  # the law itself, whatever the inputs
    pooled = (_pooled(*each, few, none) for each in every)
    return min((each for each in pooled if each), key=lambda each: each.crps.mean(), default=None)


def _recalibrated(
    model: SonarModel, law: EchoLaw, batch: Batch, names: tuple[str, ...], rng: np.random.Generator
) -> tuple[Recalibrated, RecalibratedLaw]:
    """Return a model recalibrated by readings, and the law of these by trees that lack their visits, unpooled."""
    low, high = transforms(law, batch.reading)
    given = 0.5 * (low + high) / np.maximum(law.echo / np.maximum(1.0 - law.no_answer, RARE), RARE)
    alien = batch.reading.echo & ((given < UNEXPECTED) | (given > 1.0 - UNEXPECTED))
    similar, reached, unseen = similarity(batch, names, _outcomes(law, batch, given, alien), rng)
    order = np.lexsort((batch.error, ~alien))
    whole = Recalibrated(model, similar.ordered(order), low[order], high[order], batch.error[order][: alien.sum()], 1.0)
    return whole, whole.mixture(law, batch.ping, reached, unseen)


def _pooled(whole: Recalibrated, crossed: RecalibratedLaw, batch: Batch, none: float) -> Grown | None:
    """Return the pool with the share of the least CRPS, m, which is `none` at share 0; None where share 0 has it."""
    share = _best_share(none, *(_mean_crps(crossed.pooled(share), batch) for share in (0.5, 1.0)))
    return Grown(replace(whole, share=share), batch, crossed.pooled(share)) if share > 0.0 else None


def _best_share(none: float, half: float, whole: float) -> float:
    """Return where the parabola through values at 0, 1/2 and 1 is least, within 0 to 1."""
    bend = 2.0 * (none + whole - 2.0 * half)
    return float(np.clip(0.5 + 0.5 * (none - whole) / bend, 0.0, 1.0)) if bend > 0.0 else 0.0


def _mean_crps(law: EchoLaw, batch: Batch) -> float:
    return float(np.mean(crps_with_silence(law, batch.reading, MAX_RANGE)))


def transforms(law: EchoLaw, reading: Reading) -> tuple[Floats, Floats]:
    """Return the probabilities up to the lower and the upper end of each answered reading, (n,) each."""
    answer = np.maximum(1.0 - law.no_answer, RARE)
    step = law.step(reading.range)
    echo = law.echo / answer
    low, high = (law.cdf_step(each) / answer for each in (step - 1, step))
    return np.where(reading.echo, low, echo), np.where(reading.echo, high, 1.0)


def _outcomes(law: EchoLaw, batch: Batch, given: Floats, alien: Bits) -> Floats:
    """Return what the leaves of a tree are to agree in, standardised, (n, k).

    Silence beyond the law's; echoes that are no part of it, before and behind; and where the others lie in it, as a
    normal score and its distance from the middle.
    """
    silent = ~batch.reading.echo - law.no_echo
    score = np.where(batch.reading.echo & ~alien, ndtri(np.clip(given, UNEXPECTED, 1.0 - UNEXPECTED)), 0.0)
    spread = np.where(batch.reading.echo & ~alien, np.abs(score) - MEAN_ABS_NORMAL, 0.0)
    return standardised(silent, alien & (given < 0.5), alien & (given > 0.5), score, spread)
