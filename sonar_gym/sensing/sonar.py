"""A set of sonars with one model: random streams, previous readings, and tables of credence."""

from __future__ import annotations

import os
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, cast

import numpy as np
from gymnasium import spaces

from acquisition import EchoStatus, Ping, Reading, SettingError
from acquisition.arrays import Bits, Floats, Ints
from noise import ConditionPrior, CredenceTable, EchoLaw, SonarModel, listener, load_model, model_names
from noise.faults import Faulty, FaultyLaw
from noise.law import UniformSource
from noise.learned.persistence import Persistence
from noise.model import StatefulModel
from sonar_gym.compiled import compiled
from sonar_gym.sensing.detection import is_own_echo
from sonar_gym.sensing.paths import MAX_PATHS
from sonar_gym.sensing.persistence import PersistentStream

SonarChoice = str | os.PathLike[str] | SonarModel
Copies = Sequence[int] | Ints
STREAM_TAG = 0x50E4  # separates the sonars' random stream from that of the streets: SeedSequence([seed, tag])
REARM_M = 0.43  # m; an SRF08 detects a second echo 2.5 ms after the first at the earliest (`Unit.rearm` of the rig)
SLOTS = MAX_PATHS  # faces that a model with a state of its own remembers for each sonar, as many as a ping can have
NO_FACE = -2  # of an unused place in that memory; an empty cone has face -1
BINS = 100  # bins of range in tables of credence; the broad prior has two distances per bin, so that none is empty
BEARINGS_DEG = (0.0, 7.5, 15.0, 22.5, 27.5)  # deg; inside a cone of 55 deg


def sonar_spaces(count: int) -> dict[str, spaces.Space[Any]]:
    """Return the observation spaces of `count` sonars: one-dimensional, float32, bounded."""
    limits = {"ranges": 0.0, "credence": 0.0, "echo": -1.0}
    return {name: spaces.Box(low, 1.0, (count,), np.float32) for name, low in limits.items()}


def resolve(sonar: SonarChoice) -> SonarModel:
    """Return a model by name, by the path of its folder, or as given."""
    if isinstance(sonar, str) and sonar in model_names():
        return _named(sonar)
    if isinstance(sonar, (str, os.PathLike)):
        return load_model(sonar)
    if isinstance(sonar, SonarModel):
        return sonar
    raise SettingError(f"sonar is a {type(sonar).__name__}, expected a name, the path of a model, or a SonarModel")


def persistence_of(model: Any) -> Persistence | None:
    """Return the part of a model's spread that persists, also of a model with faults; None if it has none."""
    return persistence_of(model.model) if isinstance(model, Faulty) else getattr(model, "persistence", None)


@lru_cache
def _named(name: str) -> SonarModel:
    """Return one instance per name, so that its credence is tabulated once; models in folders may change on disk."""
    return load_model(name)


def bin_edges(max_range: float) -> Floats:
    """Return the edges of the bins in which credence is tabulated, m, (BINS + 1,)."""
    return np.linspace(0.0, 1.1 * max_range, BINS + 1)


def broad_table(model: SonarModel, max_range: float) -> CredenceTable:
    """Return the credence of a model's readings under a broad prior; computed once per model.

    Distances up to `max_range` m, bearings in the cone (equal to the incidences) and reflectances are equally likely.
    """
    return _broad_table(cast(Hashable, model), max_range)


@lru_cache(maxsize=16)
def _broad_table(model: Any, max_range: float) -> CredenceTable:
    prior = ConditionPrior(near=0.01, far=max_range, distances=2 * BINS, angles_deg=BEARINGS_DEG)
    return CredenceTable.over(model, prior.grid()[0], bin_edges(max_range))


@compiled
def assign_slots(sensors: Ints, faces: Ints, slot_faces: Ints, slot_used: Ints) -> tuple[Ints, Bits]:
    """Return the place in memory of each path, and whether its face is new there, both (m,).

    Args:
        sensors: sonar of each path, those of one ping in sequence, (m,).
        faces: face of each path, (m,).
        slot_faces: face at each place of each sonar, (n, k); a new face gets the place used longest ago.
        slot_used: number of the last use of each place, (n, k); updated.
    """
    slots, new = np.empty(len(sensors), np.int64), np.zeros(len(sensors), np.bool_)
    for i in range(len(sensors)):
        sensor, place = sensors[i], -1
        for k in range(slot_faces.shape[1]):
            if slot_faces[sensor, k] == faces[i]:
                place = k
        if place < 0:
            place, new[i] = int(np.argmin(slot_used[sensor])), True
            slot_faces[sensor, place] = faces[i]
        slot_used[sensor, place] = slot_used[sensor].max() + 1
        slots[i] = sensor * slot_faces.shape[1] + place
    return slots, new


class CopyStreams:
    """The generators of several copies as one `UniformSource`: each ping's numbers come from its copy's generator.

    A law with `uniform_per_ping` then gives each copy the same readings as if it were sampled alone.

    Args:
        rngs: one generator per copy.
        counts: number of pings of each copy.
    """

    def __init__(self, rngs: Sequence[np.random.Generator], counts: Sequence[int]) -> None:
        self._rngs, self._counts = rngs, counts
        self._equal = len(set(counts)) == 1

    def random(self, size: int | tuple[int, ...], /) -> Floats:
        """Return uniform random numbers of shape `size`, whose last axis must be the pings."""
        shape = size if isinstance(size, tuple) else (size,)
        if not shape or shape[-1] != sum(self._counts):
            raise ValueError(f"a law asked for {shape} random numbers for {sum(self._counts)} pings: expected (..., n)")
        lead = shape[:-1]
        if not self._equal:
            parts = [rng.random((*lead, n)) for rng, n in zip(self._rngs, self._counts, strict=True)]
            return np.concatenate(parts, axis=-1)
        rows = np.empty((len(self._rngs), *lead, self._counts[0]))
        for rng, row in zip(self._rngs, rows, strict=True):
            rng.random(out=row)
        return np.ascontiguousarray(np.moveaxis(rows, 0, -2)).reshape(shape)


@dataclass(frozen=True)
class Draw:
    """Readings drawn for n pings.

    Attributes:
        reading: readings; an echo beyond the maximum range is no echo.
        credence_given_condition: probability of a reading within 10 % of a reflector in the cone, (n,); None if the
            model has no probabilities.
        fault: number of the model's fault that affects each reading, 0 for none, (n,); None if the model has no faults.
        path: number of the path that answered, or else of the last path of the ping, (n,).
        second: range of the second echo, m, (n,); 0 without one.
    """

    reading: Reading
    credence_given_condition: Floats | None
    fault: Ints | None
    path: Ints
    second: Floats


class _PathDraw(NamedTuple):
    """Readings of m paths, each as if it were alone in the cone; see `Draw`."""

    reading: Reading
    credence: Floats | None
    fault: Ints | None


class Sonar:
    """Draws the readings of a set of sonars in one batch, for any number of copies of the set.

    Args:
        model: sonar model, or its name or path.
        count: number of sonars in the set.
        max_range: maximum range, m.
        tag: tag of the random stream; two sets of sonars in one environment need different tags.
        tables: credence given a reading for each sonar, on `bin_edges`; default: that of the broad prior.
        copies: number of copies, one per environment; each has its own random stream and previous readings.

    Attributes:
        batched: whether the pings of several copies are sampled in one call.
        has_credence: whether the model gives credence given the condition.
        causes: names of the model's faults.
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
        # checked once: isinstance with a protocol is slow
        self._stateful = self.model if isinstance(self.model, StatefulModel) else None
        self.count, self.copies = count, copies
        self.max_range = max_range
        tables = [broad_table(shared, max_range)] * count if tables is None else tables
        self.edges, self.tables = bin_edges(max_range), np.stack([table.values for table in tables])
        self.rngs = [np.random.default_rng() for _ in range(copies)]
        self.batched = copies > 1 and listener(shared).law(Ping.of(distance=[1.0]), None).uniform_per_ping
        self.has_credence = True  # updated by each law
        self.causes = self.model.causes[1:] if isinstance(self.model, Faulty) else ()
        self.persistence = persistence_of(shared)
        self._episodes = np.zeros(copies, dtype=np.int64)  # numbers from which the persisting errors are derived
        slots = 1 if self._stateful is None else SLOTS
        size = copies * count * slots
        self._past = np.zeros(size), np.full(size, EchoStatus.NO_ANSWER, dtype=np.uint8)
        if self._stateful is not None:  # makes room for all places, which several threads must not do at once
            self._stateful.law(Ping.of(distance=[1.0]), None, np.array([size - 1]))
        self._slot_faces = np.full((copies * count, slots), NO_FACE, dtype=np.int64)
        self._slot_used = np.zeros((copies * count, slots), dtype=np.int64)
        self.clear_memory()

    def seed(self, seed: int, copy: int = 0) -> None:
        """Restart the random stream of one copy; streams with other tags are independent of it."""
        self.rngs[copy] = np.random.default_rng(np.random.SeedSequence([seed, self.tag]))

    def clear_memory(self, copies: Copies | None = None) -> None:
        """Clear the previous readings of all copies, or of some, at the start of an episode; errors are drawn anew."""
        for copy in range(self.copies) if copies is None else copies:
            self._episodes[copy] = self.rngs[copy].integers(2**62)
        which, shape = slice(None) if copies is None else copies, (self.copies, -1)
        self._past[0].reshape(shape)[which], self._past[1].reshape(shape)[which] = 0.0, EchoStatus.NO_ANSWER
        self._slot_faces.reshape(shape)[which], self._slot_used.reshape(shape)[which] = NO_FACE, 0
        if self._stateful is not None:
            self._stateful.reset(np.arange(len(self._past[0])).reshape(shape)[which].ravel())

    def draw(
        self,
        ping: Ping,
        copies: Copies,
        counts: Sequence[int],
        index: Ints,
        first: Ints,
        faces: Ints,
        latent: Floats | None = None,
        shift: Floats | None = None,
    ) -> Draw:
        """Draw the readings of some sonars of some copies; the paths of a ping compete, and the first echo is read.

        The last path of a ping is the one detected most often: its law also holds false alarms and silence, which a
        sensor has once per ping. Each other path adds an echo of its own reflector, so that a reflector masks another
        only by an echo that is received.

        Args:
            ping: conditions of the paths, ping by ping and copy by copy, (m,).
            copies: numbers of the copies.
            counts: number of paths of each of these copies.
            index: number of each ping's sonar among the sonars of all copies, (n,).
            first: number of the first path of each ping, (n,).
            faces: number of the face of each path, -1 for none, (m,); a stateful model remembers each face by itself.
            latent: persisting numbers of the paths, see `persistence.latents`, (LATENTS, m); None to draw all anew.
            shift: what is added to the reading of each path, m, (m,), for bursts sent at another time; None: nothing.
        """
        sensors = index if len(index) == len(ping) else np.repeat(index, np.diff(first, append=len(ping)))
        if self._stateful is not None:
            sensors = self._memory_slots(sensors, faces)
        past = self._previous(sensors) if self.model.remembers else None
        if self.batched or len(copies) == 1:
            each = self._draw(ping, past, sensors, self._stream(copies, counts), latent)
        else:
            each = self._draw_each(ping, past, sensors, copies, counts, latent)
        drawn = self._first_echo(ping, each, first, shift)
        if self.model.remembers:
            places, said = (index, drawn.reading) if self._stateful is None else (sensors, each.reading)
            self._past[0][places], self._past[1][places] = said.range, said.status
        return drawn

    def _memory_slots(self, sensors: Ints, faces: Ints) -> Ints:
        """Return the place in a stateful model's memory of each path, (m,); faces that are new get an empty one."""
        assert self._stateful is not None
        slots, new = assign_slots(sensors, faces, self._slot_faces, self._slot_used)
        if new.any():
            self._stateful.reset(slots[new])
            self._past[0][slots[new]], self._past[1][slots[new]] = 0.0, EchoStatus.NO_ANSWER
        return slots

    def keys(self, index: Ints) -> Ints:
        """Return the number of the episode and sonar from which persisting errors are derived, (n,)."""
        return self._episodes[index // self.count] + index % self.count

    def _first_echo(self, ping: Ping, each: _PathDraw, first: Ints, shift: Floats | None) -> Draw:
        """Return the first echo of each ping, and the second, among those of its paths."""
        last = np.append(first[1:], len(ping)) - 1
        if len(first) == len(ping):
            return Draw(each.reading, each.credence, each.fault, last, np.zeros(len(ping)))
        main = np.zeros(len(ping), dtype=np.bool_)
        main[last] = True
        counted = each.reading.echo & (main | is_own_echo(ping.distance, each.reading))
        status, fault = each.reading.status[last], None
        if each.fault is not None:
            fault = each.fault[last]
            counted &= main | (each.fault == 0)
        alone = status == EchoStatus.NO_ANSWER if fault is None else (status == EchoStatus.NO_ANSWER) | (fault > 0)
        counted &= main | ~np.repeat(alone, last - first + 1)
        echo = np.where(counted, each.reading.range if shift is None else each.reading.range + shift, np.inf)
        echo[echo > self.max_range] = np.inf
        nearest = np.minimum.reduceat(echo, first)
        answers = np.isfinite(nearest)
        owner = np.repeat(np.arange(len(first)), last - first + 1)
        path = last.copy()
        hit = np.flatnonzero(counted & (echo == nearest[owner]))[::-1]  # of equal echoes, that of the first path
        path[owner[hit]] = hit
        rest = np.where(echo > nearest[owner] + REARM_M, echo, np.inf)
        second = np.minimum.reduceat(rest, first)
        kind = np.where(answers, np.uint8(EchoStatus.ECHO), status)
        reading = Reading(np.where(answers, nearest, 0.0), kind.astype(np.uint8))
        second = np.where(np.isfinite(second), second, 0.0)
        return Draw(reading, self._any_right(each.credence, first), fault, path, second)

    def _any_right(self, credence: Floats | None, first: Ints) -> Floats | None:
        """Return P(a reflector in the cone gives an echo within 10 %), (n,), from that of each path alone."""
        return None if credence is None else 1.0 - np.multiply.reduceat(1.0 - credence, first)

    def _stream(self, copies: Copies, counts: Sequence[int]) -> UniformSource:
        rngs = [self.rngs[copy] for copy in copies]
        return rngs[0] if len(rngs) == 1 else CopyStreams(rngs, counts)

    def _draw(
        self, ping: Ping, past: Reading | None, sensors: Ints, rng: UniformSource, latent: Floats | None
    ) -> _PathDraw:
        if latent is not None and self.persistence is not None:
            rng = PersistentStream(rng, latent, self.persistence)
        law = self._law(ping, past, sensors)
        self.has_credence = law.has_probabilities
        reading, fault = law.draw(rng) if isinstance(law, FaultyLaw) else (law.sample(rng), None)
        return _PathDraw(self._in_range(reading), law.credence() if self.has_credence else None, fault)

    def _law(self, ping: Ping, past: Reading | None, sensors: Ints) -> EchoLaw:
        return self.model.law(ping, past) if self._stateful is None else self._stateful.law(ping, past, sensors)

    def _previous(self, index: Ints) -> Reading | None:
        """Return the previous readings; None if there are none and the model keeps no state of its own."""
        status = self._past[1][index]
        if self._stateful is not None or np.any(status != EchoStatus.NO_ANSWER):
            return Reading(self._past[0][index], status)
        return None

    def _draw_each(
        self,
        ping: Ping,
        past: Reading | None,
        sensors: Ints,
        copies: Copies,
        counts: Sequence[int],
        latent: Floats | None,
    ) -> _PathDraw:
        """Draw one copy after another, for laws that cannot be sampled from several streams at once."""
        parts, end = [], 0
        for copy, count in zip(copies, counts, strict=True):
            rows, end = slice(end, end + count), end + count
            if count:
                before = None if past is None else past[rows]
                own = None if latent is None else latent[:, rows]
                parts.append(self._draw(ping[rows], before, sensors[rows], self.rngs[copy], own))
        reading = Reading(
            *(np.concatenate([getattr(part.reading, name) for part in parts]) for name in ("range", "status"))
        )
        credence = [part.credence for part in parts if part.credence is not None]
        fault = [part.fault for part in parts if part.fault is not None]
        return _PathDraw(
            reading, np.concatenate(credence) if credence else None, np.concatenate(fault) if fault else None
        )

    def credence(self, reading: Reading) -> Floats:
        """Return the credence given each sonar's reading, (copies * count,); 0 without an echo."""
        sonar = np.arange(len(reading)) % self.count
        place = np.minimum(np.searchsorted(self.edges, reading.range, side="right") - 1, BINS - 1)
        return np.where(reading.echo, self.tables[sonar, place], 0.0)

    def _in_range(self, reading: Reading) -> Reading:
        """Replace echoes beyond the maximum range by no echo."""
        beyond = reading.range > self.max_range
        if not beyond.any():
            return reading
        status = np.where(beyond, np.uint8(EchoStatus.NO_ECHO), reading.status)
        return Reading(np.where(beyond, 0.0, reading.range), status)
