"""Sonars that share a model: random streams, previous readings, and tables of credence given a reading."""

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
from noise import ConditionPrior, CredenceTable, EchoLaw, SonarModel, listener, load_model, model_names
from noise.law import UniformSource
from noise.model import StatefulModel

Floats = NDArray[np.float64]
SonarChoice = str | os.PathLike[str] | SonarModel
Copies = Sequence[int] | NDArray[np.int64]
STREAM_TAG = 0x50E4  # separates the stream of the sonars from that of the world: SeedSequence([seed, tag])
ECHO_CODE = np.array([0.0, 1.0, -1.0], dtype=np.float32)  # by EchoStatus: no echo, echo, no answer
BINS = 100  # bins of range in credence tables; the broad prior has two distances in each, so that none is empty
BEARINGS_DEG = (0.0, 7.5, 15.0, 22.5, 27.5)  # inside a cone of 55 deg


@dataclass(frozen=True)
class SonarReadings:
    """Readings of s sonars, one ping each.

    Attributes:
        reading: the readings. Readings beyond the maximum range count as no echo.
        credence: credence given the reading alone, 0..1, (s,); 0 without an echo.
        credence_given_condition: credence given the true condition, 0..1, (s,); 0 for an empty cone.
    """

    reading: Reading
    credence: Floats
    credence_given_condition: Floats


def sonar_spaces(count: int) -> dict[str, spaces.Space[Any]]:
    """Return the observation spaces of `count` sonars: bounded, 1-D, float32."""
    limits = {"ranges": 0.0, "credence": 0.0, "echo": -1.0}
    return {name: spaces.Box(low, 1.0, (count,), np.float32) for name, low in limits.items()}


def resolve(sonar: SonarChoice) -> SonarModel:
    """Return a model given by name, by the path of its folder, or as an instance."""
    if isinstance(sonar, str) and sonar in model_names():
        return _named(sonar)
    if isinstance(sonar, (str, os.PathLike)):
        return load_model(sonar)
    if isinstance(sonar, SonarModel):
        return sonar
    raise SettingError(f"sonar is a {type(sonar).__name__}, expected a name, the path of a model, or a SonarModel")


@lru_cache
def _named(name: str) -> SonarModel:
    """Return one shared instance per name, so that credence is tabulated once. Models in folders may change."""
    return load_model(name)


def bin_edges(max_range: float) -> Floats:
    """Return the bin edges of the credence tables, m, (BINS + 1,)."""
    return np.linspace(0.0, 1.1 * max_range, BINS + 1)


def broad_table(model: SonarModel, max_range: float) -> CredenceTable:
    """Return the credence of readings of a model under a broad prior; cached per model.

    The prior is uniform over distances up to `max_range` m, bearings in the cone (incidences equal them) and
    reflectances.
    """
    return _broad_table(cast(Hashable, model), max_range)


@lru_cache(maxsize=16)
def _broad_table(model: Any, max_range: float) -> CredenceTable:
    prior = ConditionPrior(near=0.01, far=max_range, distances=2 * BINS, angles_deg=BEARINGS_DEG)
    return CredenceTable.over(model, prior.grid()[0], bin_edges(max_range))


class Streams:
    """The generators of several copies as one `UniformSource`.

    The numbers of the pings of a copy come from the generator of that copy, so a law that takes one column of uniform
    numbers per ping draws the same readings as for each copy alone.

    Args:
        rngs: one generator per copy.
        each: number of pings of each copy, in the same order.
    """

    def __init__(self, rngs: Sequence[np.random.Generator], each: Sequence[int]) -> None:
        self._rngs, self._each = rngs, each
        self._equal = len(set(each)) == 1

    def random(self, size: int | tuple[int, ...], /) -> Floats:
        """Return uniform random numbers, (..., pings)."""
        lead = () if isinstance(size, (int, np.integer)) else tuple(size[:-1])
        if not self._equal:
            parts = [rng.random((*lead, n)) for rng, n in zip(self._rngs, self._each, strict=True)]
            return np.concatenate(parts, axis=-1)
        rows = np.empty((len(self._rngs), *lead, self._each[0]))
        for rng, row in zip(self._rngs, rows, strict=True):
            rng.random(out=row)
        return np.ascontiguousarray(np.moveaxis(rows, 0, -2)).reshape(*lead, sum(self._each))


def uniform_per_ping(model: SonarModel) -> bool:
    """Return whether the laws of a model declare that they take one column of uniform numbers per ping."""
    return listener(model).law(Ping.of(distance=[1.0]), None).uniform_per_ping


@dataclass(frozen=True)
class Draw:
    """Random draw for n pings.

    Attributes:
        reading: the readings. Readings beyond the maximum range count as no echo.
        credence_given_condition: (n,), or None if the model has no probabilities.
        fault: number of the fault of the model behind each reading, 0 for none, (n,); None if it has no faults.
    """

    reading: Reading
    credence_given_condition: Floats | None
    fault: NDArray[np.int64] | None


class Sonar:
    """Draws the readings of a set of sonars, for any number of copies of the set, in one batch.

    Args:
        model: name, path or instance of the model.
        count: number of sonars in a set.
        max_range: maximum range, m.
        tag: tag of the random stream; two sets in one environment need different tags.
        tables: credence given a reading on `bin_edges`, one table per sonar; the broad prior by default.
        copies: number of copies (environments), each with its own random stream and previous readings.
    """

    def __init__(
        self,
        model: SonarChoice,
        count: int,
        max_range: float,
        tag: int = STREAM_TAG,
        tables: Sequence[CredenceTable] | None = None,
        copies: int = 1,
    ) -> None:
        self.tag = tag
        shared = resolve(model)
        self.model = listener(shared)
        self._has_memory = isinstance(self.model, StatefulModel)  # cached: checking a protocol is slow
        self.count, self.copies = count, copies
        self.max_range = max_range
        tables = [broad_table(shared, max_range)] * count if tables is None else tables
        self.edges, self.tables = bin_edges(max_range), np.stack([table.values for table in tables])
        self.rngs = [np.random.default_rng() for _ in range(copies)]
        self.batched = copies > 1 and uniform_per_ping(self.model)
        self.has_credence = True  # until a law has no probabilities
        self.causes = tuple(getattr(self.model, "causes", ("none",)))[1:]
        self._past = np.zeros(copies * count), np.full(copies * count, EchoStatus.NO_ANSWER, dtype=np.uint8)
        self._seats = np.arange(copies * count)
        self.forget()

    @property
    def rng(self) -> np.random.Generator:
        """The stream of the first copy."""
        return self.rngs[0]

    def seed(self, seed: int, copy: int = 0) -> None:
        """Seed the stream of a copy. The stream differs from that of a world with the same seed."""
        self.rngs[copy] = np.random.default_rng(np.random.SeedSequence([seed, self.tag]))

    def forget(self, copies: Copies | None = None) -> None:
        """Clear the previous readings of all copies or of some, at the start of an episode."""
        which, shape = slice(None) if copies is None else copies, (self.copies, self.count)
        self._past[0].reshape(shape)[which], self._past[1].reshape(shape)[which] = 0.0, EchoStatus.NO_ANSWER
        if self._has_memory:
            cast(StatefulModel, self.model).reset(None if copies is None else self._seats.reshape(shape)[which].ravel())

    def draw(self, ping: Ping, copies: Copies, each: Sequence[int], place: slice | NDArray[np.int64]) -> Draw:
        """Draw readings of some sonars of some copies.

        Args:
            ping: the conditions, ordered by copy.
            copies: the copies.
            each: number of pings of each of these copies.
            place: index of the sonar of each ping among all sonars of all copies.
        """
        past, seats = self._before(place) if self.model.remembers else None, self._seats[place]
        if self.batched or len(copies) == 1:
            drawn = self._draw(ping, past, seats, self._stream(copies, each))
        else:
            drawn = self._draw_apart(ping, past, seats, copies, each)
        if self.model.remembers:
            self._past[0][place], self._past[1][place] = drawn.reading.range, drawn.reading.status
        return drawn

    def _stream(self, copies: Copies, each: Sequence[int]) -> UniformSource:
        if len(copies) == 1:
            return self.rngs[copies[0]]
        return Streams([self.rngs[copy] for copy in copies], each)

    def _draw(self, ping: Ping, past: Reading | None, seats: NDArray[np.int64], rng: UniformSource) -> Draw:
        model: Any = self.model
        law: Any = model.law(ping, past, seats) if self._has_memory else model.law(ping, past)
        reading, fault = law.draw(rng) if self.causes else (law.sample(rng), None)
        return Draw(self._gate(reading), self._given(law), fault)

    def _given(self, law: EchoLaw) -> Floats | None:
        """Return the credence given the condition; None if the law has no probabilities."""
        self.has_credence = law.has_probabilities
        return law.credence() if law.has_probabilities else None

    def _before(self, place: slice | NDArray[np.int64]) -> Reading | None:
        """Return the previous readings, or None if there are none and the model keeps no state."""
        status = self._past[1][place]
        if self._has_memory:
            return Reading(self._past[0][place], status)
        return Reading(self._past[0][place], status) if np.any(status != EchoStatus.NO_ANSWER) else None

    def _draw_apart(
        self, ping: Ping, past: Reading | None, seats: NDArray[np.int64], copies: Copies, each: Sequence[int]
    ) -> Draw:
        """Draw copy by copy, each from its own stream, for laws that do not use one uniform number per ping."""
        parts, end = [], 0
        for copy, count in zip(copies, each, strict=True):
            rows, end = slice(end, end + count), end + count
            if count:
                before = None if past is None else past[rows]
                parts.append(self._draw(ping[rows], before, seats[rows], self.rngs[copy]))
        reading = Reading(
            *(np.concatenate([getattr(part.reading, name) for part in parts]) for name in ("range", "status"))
        )
        given = [part.credence_given_condition for part in parts if part.credence_given_condition is not None]
        fault = [part.fault for part in parts if part.fault is not None]
        return Draw(reading, np.concatenate(given) if given else None, np.concatenate(fault) if fault else None)

    def credence(self, reading: Reading) -> Floats:
        """Return the credence given the reading of each sonar, (copies * count,); 0 without an echo."""
        sonar = np.arange(len(reading)) % self.count
        place = np.minimum(np.searchsorted(self.edges, reading.range, side="right") - 1, BINS - 1)
        return np.where(reading.echo, self.tables[sonar, place], 0.0)

    def _gate(self, reading: Reading) -> Reading:
        late = reading.range > self.max_range
        if not late.any():
            return reading
        status = np.where(late, np.uint8(EchoStatus.NO_ECHO), reading.status)
        return Reading(np.where(late, 0.0, reading.range), status)
