"""A set of sonars that share a model: its own random stream, its memory, and its credence table."""

from __future__ import annotations

import os
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from acquisition import EchoStatus, Ping, Reading, SettingError
from noise import ConditionPrior, CredenceTable, SonarModel, listener, load_model

Floats = NDArray[np.float64]
SonarChoice = str | os.PathLike[str] | SonarModel
STREAM_TAG = 0x50E4  # keeps the sonars' stream apart from the world's: SeedSequence([seed, tag])
ECHO_CODE = np.array([0.0, 1.0, -1.0], dtype=np.float32)  # by EchoStatus: silence, echo, no answer
BINS = 100  # of range, in tables of credence; the broad prior puts two distances into each, so that none is empty
BEARINGS_DEG = (0.0, 7.5, 15.0, 22.5, 27.5)  # inside the cone of a sonar of 55 deg


@dataclass(frozen=True)
class Heard:
    """What s sonars said to one ping each.

    Attributes:
        reading: the readings; what lies beyond the listening range is silence.
        credence: given the readings alone, 0..1, (s,); 0 without an echo.
        credence_given_condition: needs the truth, 0..1, (s,); 0 where the cone is empty.
    """

    reading: Reading
    credence: Floats
    credence_given_condition: Floats

    def observation(self, max_range: float) -> dict[str, NDArray[np.float32]]:
        """Return what an agent gets, each (s,), inside `sonar_spaces`.

        `ranges`: shares of `max_range` m, 1 where there is no echo; `credence`: given the reading; `echo`: 1 for an
        echo, 0 for silence, -1 for no answer.
        """
        ranges = np.where(self.reading.echo, self.reading.range / max_range, 1.0)
        return {
            "ranges": np.minimum(ranges, 1.0).astype(np.float32),
            "credence": self.credence.astype(np.float32),
            "echo": ECHO_CODE[self.reading.status],
        }


def sonar_spaces(count: int) -> dict[str, spaces.Space[Any]]:
    """Return the spaces of what `count` sonars say: 1-D, float32, bounded."""
    limits = {"ranges": 0.0, "credence": 0.0, "echo": -1.0}
    return {name: spaces.Box(low, 1.0, (count,), np.float32) for name, low in limits.items()}


def resolve(sonar: SonarChoice) -> SonarModel:
    """Return a model by name, by the path of its folder, or as it is."""
    if isinstance(sonar, (str, os.PathLike)):
        return load_model(sonar)
    if isinstance(sonar, SonarModel):
        return sonar
    raise SettingError(f"sonar is a {type(sonar).__name__}, expected a name, the path of a model, or a SonarModel")


def bin_edges(max_range: float) -> Floats:
    """Return the edges of the bins in which credence is tabulated, m, (BINS + 1,)."""
    return np.linspace(0.0, 1.1 * max_range, BINS + 1)


def broad_table(model: SonarModel, max_range: float) -> CredenceTable:
    """Return the credence of a model's readings where little is known of the scene; computed once a model.

    The prior: distances equally likely up to `max_range` m, bearings (and incidences, alike) in the cone, reflectances.
    """
    return _broad_table(cast(Hashable, model), max_range)


@lru_cache(maxsize=16)
def _broad_table(model: Any, max_range: float) -> CredenceTable:
    prior = ConditionPrior(near=0.01, far=max_range, distances=2 * BINS, angles_deg=BEARINGS_DEG)
    return CredenceTable.over(model, prior.grid()[0], bin_edges(max_range))


class Sonar:
    """Draws the readings of `count` sonars in one batch.

    Args:
        model: by name, path or itself.
        count: number of sonars.
        max_range: greatest range listened to, m.
        tag: of the random stream; two sets of sonars in one environment need two.
        tables: credence given a reading, one a sonar, on `bin_edges`; without, the broad prior's for all.
    """

    def __init__(
        self,
        model: SonarChoice,
        count: int,
        max_range: float,
        tag: int = STREAM_TAG,
        tables: Sequence[CredenceTable] | None = None,
    ) -> None:
        self.tag = tag
        shared = resolve(model)
        self.model = listener(shared)
        self.count = count
        self.max_range = max_range
        tables = [broad_table(shared, max_range)] * count if tables is None else tables
        self._edges, self._credence = bin_edges(max_range), np.stack([table.values for table in tables])
        self._rows = np.arange(count)
        self.rng = np.random.default_rng()
        self._past: Reading | None = None

    def seed(self, seed: int) -> None:
        """Start the stream anew; worlds seeded alike are left alone."""
        self.rng = np.random.default_rng(np.random.SeedSequence([seed, self.tag]))

    def forget(self) -> None:
        """Clear the memory of previous readings: a new episode begins."""
        self._past = None

    def listen(self, ping: Ping, seen: NDArray[np.bool_]) -> Heard:
        """Draw what every sonar says.

        Args:
            ping: the conditions, one a sonar.
            seen: whether there is anything in the cone, (count,).
        """
        law = self.model.law(ping, self._past)
        reading = self._gate(law.sample(self.rng))
        self._past = reading if self.model.remembers else None
        return Heard(reading, self.credence(reading), np.where(seen, law.credence(), 0.0))

    def credence(self, reading: Reading) -> Floats:
        """Return the credence given each sonar's reading, (count,); 0 without an echo."""
        place = np.minimum(np.searchsorted(self._edges, reading.range, side="right") - 1, BINS - 1)
        return np.where(reading.echo, self._credence[self._rows, place], 0.0)

    def _gate(self, reading: Reading) -> Reading:
        late = reading.range > self.max_range
        if not late.any():
            return reading
        status = np.where(late, np.uint8(EchoStatus.NO_ECHO), reading.status)
        return Reading(np.where(late, 0.0, reading.range), status)
