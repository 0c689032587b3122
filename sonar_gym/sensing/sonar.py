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
from noise import ConditionPrior, CredenceTable, EchoLaw, SonarModel, listener, load_model, model_names
from noise.model import Remembering
from sonar_gym.sensing.scene import EMPTY_M

Floats = NDArray[np.float64]
SonarChoice = str | os.PathLike[str] | SonarModel
Copies = Sequence[int] | NDArray[np.int64]
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


def sonar_spaces(count: int) -> dict[str, spaces.Space[Any]]:
    """Return the spaces of what `count` sonars say: 1-D, float32, bounded."""
    limits = {"ranges": 0.0, "credence": 0.0, "echo": -1.0}
    return {name: spaces.Box(low, 1.0, (count,), np.float32) for name, low in limits.items()}


def resolve(sonar: SonarChoice) -> SonarModel:
    """Return a model by name, by the path of its folder, or as it is."""
    if isinstance(sonar, str) and sonar in model_names():
        return _named(sonar)
    if isinstance(sonar, (str, os.PathLike)):
        return load_model(sonar)
    if isinstance(sonar, SonarModel):
        return sonar
    raise SettingError(f"sonar is a {type(sonar).__name__}, expected a name, the path of a model, or a SonarModel")


@lru_cache
def _named(name: str) -> SonarModel:
    """Return a model by name, one for all: so credence is tabulated once. What lies in a folder may be trained anew."""
    return load_model(name)


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


class Streams:
    """The generators of several copies as one: what a law draws for a copy's pings comes from that copy's generator.

    A law that draws one number a ping, any number of times, so says of each copy just what it would say of it alone.

    Args:
        rngs: one a copy.
        each: pings of each copy, in their order.
    """

    def __init__(self, rngs: Sequence[np.random.Generator], each: Sequence[int]) -> None:
        self._rngs, self._each = rngs, each
        self._even = len(set(each)) == 1

    def random(self, size: int | tuple[int, ...] | None = None) -> Floats:
        """Return uniform numbers, (..., pings)."""
        shape = (size,) if isinstance(size, (int, np.integer)) else tuple(size or ())
        if not shape or shape[-1] != sum(self._each):
            raise NotAlike(f"{shape} numbers for {sum(self._each)} pings")
        lead = shape[:-1]
        if not self._even:
            parts = [rng.random((*lead, n)) for rng, n in zip(self._rngs, self._each, strict=True)]
            return np.concatenate(parts, axis=-1)
        rows = np.empty((len(self._rngs), *lead, self._each[0]))
        for rng, row in zip(self._rngs, rows, strict=True):
            rng.random(out=row)
        return np.ascontiguousarray(np.moveaxis(rows, 0, -2)).reshape(shape)


class NotAlike(ValueError):
    """A law draws otherwise than a number a ping."""


def draws_alike(model: SonarModel) -> bool:
    """Return whether a model's laws can be drawn for several copies at once, by trying it."""
    ping = Ping.of(distance=[0.2, 1.0, EMPTY_M, 0.7, 2.5, 0.4], run=np.arange(6))
    alone = [np.random.default_rng(k) for k in range(2)]
    try:
        both = (
            listener(model)
            .law(ping, None)
            .sample(cast(np.random.Generator, Streams([np.random.default_rng(k) for k in range(2)], [3, 3])))
        )
    except (AttributeError, TypeError, NotAlike):
        return False
    halves = zip(([0, 1, 2], [3, 4, 5]), alone, strict=True)
    apart = [listener(model).law(ping[rows], None).sample(rng) for rows, rng in halves]
    said = np.concatenate([reading.range for reading in apart])
    return bool(np.array_equal(both.range, said))


@dataclass(frozen=True)
class Draw:
    """What was drawn for n pings.

    Attributes:
        reading: what lies beyond the listening range is silence.
        credence_given_condition: (n,), or None where the model cannot tell.
        fault: number of the model's fault that struck, 0 for none, (n,).
    """

    reading: Reading
    credence_given_condition: Floats | None
    fault: NDArray[np.int64] | None


class Sonar:
    """Draws the readings of `count` sonars in one batch, for any number of copies of them.

    Args:
        model: by name, path or itself.
        count: number of sonars.
        max_range: greatest range listened to, m.
        tag: of the random stream; two sets of sonars in one environment need two.
        tables: credence given a reading, one a sonar, on `bin_edges`; without, the broad prior's for all.
        copies: environments that have such sonars each, with a random stream and a memory of its own.
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
        self._recalls = isinstance(self.model, Remembering)  # asked once: a protocol takes its time to answer
        self.count, self.copies = count, copies
        self.max_range = max_range
        tables = [broad_table(shared, max_range)] * count if tables is None else tables
        self.edges, self.tables = bin_edges(max_range), np.stack([table.values for table in tables])
        self.rngs = [np.random.default_rng() for _ in range(copies)]
        self.at_once = copies > 1 and draws_alike(self.model)
        self.has_credence = True  # until a law says that it cannot
        self.causes = tuple(getattr(self.model, "causes", ("none",)))[1:]
        self._past = np.zeros(copies * count), np.full(copies * count, EchoStatus.NO_ANSWER, dtype=np.uint8)
        self._seats = np.arange(copies * count)
        self.forget()

    @property
    def rng(self) -> np.random.Generator:
        """The stream of the first copy."""
        return self.rngs[0]

    def seed(self, seed: int, copy: int = 0) -> None:
        """Start a copy's stream anew; worlds seeded alike are left alone."""
        self.rngs[copy] = np.random.default_rng(np.random.SeedSequence([seed, self.tag]))

    def forget(self, copies: Copies | None = None) -> None:
        """Clear the memory of previous readings: a new episode begins, for all copies or for some."""
        which, shape = slice(None) if copies is None else copies, (self.copies, self.count)
        self._past[0].reshape(shape)[which], self._past[1].reshape(shape)[which] = 0.0, EchoStatus.NO_ANSWER
        if self._recalls:
            cast(Remembering, self.model).reset(None if copies is None else self._seats.reshape(shape)[which].ravel())

    def draw(self, ping: Ping, copies: Copies, each: Sequence[int], place: slice | NDArray[np.int64]) -> Draw:
        """Draw what some sonars of some copies say.

        Args:
            ping: the conditions, copy after copy.
            copies: whose.
            each: number of pings of each of them.
            place: number of each ping's sonar among all of all copies.
        """
        past, seats = self._before(place) if self.model.remembers else None, self._seats[place]
        if self.at_once or len(copies) == 1:
            drawn = self._draw(ping, past, seats, self._stream(copies, each))
        else:
            drawn = self._draw_apart(ping, past, seats, copies, each)
        if self.model.remembers:
            self._past[0][place], self._past[1][place] = drawn.reading.range, drawn.reading.status
        return drawn

    def _stream(self, copies: Copies, each: Sequence[int]) -> np.random.Generator:
        if len(copies) == 1:
            return self.rngs[copies[0]]
        return cast(np.random.Generator, Streams([self.rngs[copy] for copy in copies], each))

    def _draw(self, ping: Ping, past: Reading | None, seats: NDArray[np.int64], rng: np.random.Generator) -> Draw:
        model: Any = self.model
        law: Any = model.law(ping, past, seats) if self._recalls else model.law(ping, past)
        reading, fault = law.draw(rng) if self.causes else (law.sample(rng), None)
        return Draw(self._gate(reading), self._given(law), fault)

    def _given(self, law: EchoLaw) -> Floats | None:
        """Return credence given the condition; None where a law can only be drawn from."""
        self.has_credence = law.has_probabilities
        return law.credence() if law.has_probabilities else None

    def _before(self, place: slice | NDArray[np.int64]) -> Reading | None:
        """Return the readings before, or None where nothing is known of any and no memory says since when."""
        status = self._past[1][place]
        if self._recalls:
            return Reading(self._past[0][place], status)
        return Reading(self._past[0][place], status) if np.any(status != EchoStatus.NO_ANSWER) else None

    def _draw_apart(
        self, ping: Ping, past: Reading | None, seats: NDArray[np.int64], copies: Copies, each: Sequence[int]
    ) -> Draw:
        """Draw for one copy after the other, each from its own stream: for laws that draw in ways of their own."""
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
        """Return the credence given each sonar's reading, (copies * count,); 0 without an echo."""
        sonar = np.arange(len(reading)) % self.count
        place = np.minimum(np.searchsorted(self.edges, reading.range, side="right") - 1, BINS - 1)
        return np.where(reading.echo, self.tables[sonar, place], 0.0)

    def _gate(self, reading: Reading) -> Reading:
        late = reading.range > self.max_range
        if not late.any():
            return reading
        status = np.where(late, np.uint8(EchoStatus.NO_ECHO), reading.status)
        return Reading(np.where(late, 0.0, reading.range), status)
