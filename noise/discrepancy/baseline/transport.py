"""Readings of a simulator carried from the law of the simulation to that of the recording.

An echo keeps its rank: it lies at the same share of the echoes of the one law as before of the other (quantile mapping,
optimal transport in one dimension; Villani 2003, section 2.2). Each law is that given the reading before in its own
file (the rearrangement of Knothe and Rosenblatt; Villani 2009, chapter 1). Where the other law is wider, what it has
more is new with every reading, as noise is, and the echo keeps its rank only in part: the normal scores of both ranks
are correlated by the ratio of the widths. An echo is lost, and silence becomes an echo, as often as the probabilities
of an echo differ. What has no name, and what no effect can do to a given reading, is carried too. Where an echo is no
part of the simulation's law, that law is wrong there, and so is the other, which rests on it: the echo moves by the
difference of their medians, in which the error cancels. An echo that the simulation's law all but excludes stays one,
and so does silence, as far as they say that the law is wrong (Bayes).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from acquisition import EchoStatus, Ping, Reading
from acquisition.arguments import checked
from acquisition.arrays import Floats
from acquisition.brief import brief
from noise.discrepancy.thresholds import SHARE_TOLERANCE
from noise.law import EchoLaw
from noise.model import SonarModel
from noise.replay import SIMULATED_BEFORE, given_readings

RARE = 1e-12  # smallest divisor
UPPER = 0.8  # quantile of a law's echoes that tells how wide it is; clear of tails; chosen here
N_RANKS = 4  # of an echo within the step of its register; chosen here
ALIEN = 1e-4  # probability in the simulation's law below which a reading is no part of it; chosen here
WRONG = SHARE_TOLERANCE  # of pings, in which the simulation's law does not know whether there is an echo


class TransportLaw(EchoLaw):
    """What given readings of one law become under another.

    Attributes:
        given: readings, (n,).
        own, law: law that they come from, and that of the readings that they become.
        correlation: of the normal scores of an echo's ranks in both laws, (n,).
        low, high: share of the echoes of the first law up to the lower and upper end of the step of each echo, (n,).
        alien: which echoes are no part of the first law, (n,).
        heard: probability that each reading becomes an echo, (n,).
    """

    uniform_per_ping = True

    def __init__(self, given: Reading, own: EchoLaw, law: EchoLaw) -> None:
        super().__init__(law.distance, law.resolution, law.max_range)
        self.given, self.own, self.law = given, own, law
        self.correlation = relative_width(own, law)
        before, after = (each.echo / np.maximum(1.0 - each.no_answer, RARE) for each in (own, law))
        self.low, self.high = (each / np.maximum(before, RARE) for each in transforms(own, given))
        place = 0.5 * (self.low + self.high)
        self.alien = given.echo & ((place < ALIEN) | (place > 1.0 - ALIEN))
        kept = after / np.maximum(before, RARE)
        gained = (after - before) / np.maximum(1.0 - before, RARE)
        heard = np.clip(np.where(given.echo, kept, gained), 0.0, 1.0)
        # the ratio of two probabilities that are both wrong says nothing
        wrong = WRONG / (WRONG + (1.0 - WRONG) * np.where(given.echo, before, 1.0 - before))
        self.heard = wrong * given.echo + (1.0 - wrong) * heard

    def _arrival(self, z: Floats) -> Floats:
        share = self.law._arrival(z) / np.maximum(self.law.echo, RARE)
        within = np.clip((share - self.low) / np.maximum(self.high - self.low, RARE), 0.0, 1.0)
        mixed = self.correlation < 1.0
        if mixed.any():
            within = np.where(mixed, self._mixed(share), within)
        carried = np.where(self.given.echo, within, share)
        if self.alien.any():
            carried = np.where(self.alien, z >= self._moved, carried)
        return (1.0 - self.no_answer) * self.heard * carried

    def _mixed(self, share: Floats) -> Floats:
        """Return the probability that echoes with a part of their rank are no farther than a share of the law's."""
        width = np.maximum(np.sqrt(1.0 - self.correlation**2), RARE)
        limit = ndtri(np.clip(share, 0.0, 1.0))
        nodes = ((k + 0.5) / N_RANKS for k in range(N_RANKS))
        scores = (ndtri(np.clip(self.low + node * (self.high - self.low), RARE, 1.0 - RARE)) for node in nodes)
        return np.asarray(sum(ndtr((limit - self.correlation * score) / width) for score in scores) / N_RANKS)

    @cached_property
    def _moved(self) -> Floats:
        """Ranges moved by the difference of the medians, m, (n,)."""
        return self.given.range + self.law.quantile(0.5) - self.own.quantile(0.5)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer): 1 where the simulator gave no answer, (n,)."""
        return (self.given.status == EchoStatus.NO_ANSWER).astype(np.float64)


@dataclass(frozen=True)
class Transport:
    """A model that carries a simulator's readings, which stand beside the conditions, from one law to another.

    Args:
        own: model of the simulator's readings.
        model: model of the readings that they become; also of pings without a reading of the simulator.
    """

    own: SonarModel
    model: SonarModel

    __repr__ = brief

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    @property
    def remembers(self) -> bool:
        """Whether a law depends on the previous reading."""
        return self.model.remembers  # the simulator's own reading before stands beside the condition

    @checked
    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the law of n pings; that of `model` where no reading of the simulator is given."""
        given, law = given_readings(ping), self.model.law(ping, past)
        if given is None:
            return law
        return TransportLaw(given, self.own.law(ping, given_readings(ping, SIMULATED_BEFORE)), law)

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data."""
        own: Any = self.own
        model: Any = self.model
        return {"kind": "transport", "own": own.to_dict(), "model": model.to_dict()}

    @classmethod
    @checked
    def load(cls, folder: Path, data: dict[str, Any], load_kind: Callable[[Path, object], SonarModel]) -> Transport:
        """Load a saved model; `load_kind` loads the inner models."""
        return cls(load_kind(folder, data["own"]), load_kind(folder, data["model"]))


def relative_width(own: EchoLaw, law: EchoLaw) -> Floats:
    """Return the width of a law's echoes relative to that of a wider one, (n,); 1 where the other is no wider.

    Echoes of one step may be as wide as the step.
    """
    widths = (each.quantile(UPPER) - each.quantile(1.0 - UPPER) + each.resolution for each in (own, law))
    return np.minimum(np.divide(*widths), 1.0)


def transforms(law: EchoLaw, reading: Reading) -> tuple[Floats, Floats]:
    """Return the probabilities up to the lower and the upper end of each answered reading, (n,) each."""
    answer = np.maximum(1.0 - law.no_answer, RARE)
    step = law.step(reading.range)
    echo = law.echo / answer
    low, high = (law.cdf_step(each) / answer for each in (step - 1, step))
    return np.where(reading.echo, low, echo), np.where(reading.echo, high, 1.0)
