"""A set of sonars with one model: random streams, previous readings, and tables of credence."""

from __future__ import annotations

import os
from collections.abc import Hashable, Sequence
from functools import lru_cache
from typing import Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from acquisition import Reading, SettingError
from acquisition.arrays import Bits, Floats, Ints
from noise import ConditionPrior, CredenceTable, SonarModel, listener, load_model, model_names
from noise.model import StatefulModel
from sonar_gym.compiled import compiled
from sonar_gym.sensing import paths as columns
from sonar_gym.sensing import records
from sonar_gym.sensing.detection import LISTENING_M
from sonar_gym.sensing.laws.choose import path_law
from sonar_gym.sensing.laws.drawn import PathPings, PathSource
from sonar_gym.sensing.laws.numbers import Streams, mixed
from sonar_gym.sensing.paths import MAX_OWN_PATHS
from sonar_gym.sensing.persistence import PersistentStream, keys_of, latents
from sonar_gym.sensing.records import FiredPings

SonarChoice = str | os.PathLike[str] | SonarModel
Copies = Sequence[int] | Ints
STREAM_TAG = 0x50E4  # separates the sonars' random stream from that of the streets: SeedSequence([seed, tag])
# Faces that a model with a state of its own remembers per sonar. The sonars of a car share its places, since few of
# them face many: 32 for eight forget 0.6 % of paths that they have met before, four for each alone 10 %
PLACES = MAX_OWN_PATHS
NOTHING_HELD = -1  # by a place; otherwise sonar times `SONAR_STRIDE`, and face + 1
SONAR_STRIDE = 1 << 20
NOTHING, NO_FAULTS = np.zeros(0), np.zeros(0, np.int64)
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
def new_episodes(copies: Ints, keys: Ints, counters: Ints) -> Ints:
    """Return a number for the episode of each copy from its stream, (r,)."""
    out = np.empty(copies.shape[0], np.int64)
    for k in range(copies.shape[0]):
        i = copies[k]
        counters[i] += 1
        out[k] = np.int64(mixed(np.uint64(keys[i]) ^ mixed(np.uint64(counters[i]))) >> np.uint64(2))
    return out


@compiled
def assign_places(
    cars: Ints, sonars: Ints, faces: Ints, held: NDArray[Any], used: NDArray[Any]
) -> tuple[Ints, Bits]:  # fmt: skip
    """Return the place in memory of each path, and whether its face is new there, both (m,).

    A face that is new takes the place of its car that was used longest ago. In one call a car has at most as many paths
    as places, so that each path has its own.

    Args:
        cars: number of the car of each path, (m,).
        sonars: number of its sonar on the car, (m,).
        faces: its face, (m,).
        held: what each place of each car holds, see `NOTHING_HELD`, (n, k); updated.
        used: number of the last use of each place, (n, k); updated.
    """
    places, new = np.empty(len(cars), np.int64), np.zeros(len(cars), np.bool_)
    for i in range(len(cars)):
        own, last_use = held[cars[i]], used[cars[i]]
        key, place, oldest, latest = sonars[i] * SONAR_STRIDE + faces[i] + 1, -1, 0, last_use[0]
        for k in range(own.shape[0]):
            place = k if own[k] == key else place
            oldest = k if last_use[k] < last_use[oldest] else oldest
            latest = max(latest, last_use[k])
        if place < 0:
            place, new[i], own[oldest] = oldest, True, key
        last_use[place] = latest + 1
        places[i] = cars[i] * own.shape[0] + place
    return places, new


class Sonar:
    """Draws the readings of a set of sonars in one batch, for any number of copies of the set.

    Args:
        model: sonar model, or its name or path.
        count: number of sonars in the set.
        max_range: maximum range, m.
        tag: tag of the random stream; two sets of sonars in one environment need different tags.
        tables: credence given a reading for each sonar, on `bin_edges`, (count, BINS); default: of the broad prior.
        copies: number of copies, one per environment; each has its own random stream and previous readings.
        persists: whether errors persist, for a model that states which part of its spread does.

    Attributes:
        rngs: random streams of the copies.
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
        tables: Floats | None = None,
        copies: int = 1,
        persists: bool = True,
    ) -> None:
        self.tag = tag
        shared = resolve(model)
        self.model = listener(shared)
        self.count, self.copies = count, copies
        self.max_range = max_range = float(max_range)  # kernels are compiled for each type of number
        if tables is None:
            tables = np.tile(broad_table(shared, max_range).values, (count, 1))
        self.edges, self.tables = bin_edges(max_range), tables
        self.rngs = Streams(copies, tag)
        self._by_face = isinstance(self.model, StatefulModel)
        self._places = count * (PLACES if self._by_face else 1)  # of each copy
        # bursts of others may come from farther than the readings, which `first_echoes` cuts
        self.law = path_law(self.model, copies * self._places, max(max_range, LISTENING_M))
        self.batched, self.has_credence = self.law.batched, self.law.has_probabilities
        self.causes: tuple[str, ...] = getattr(shared, "causes", ("none",))[1:]
        self.persistence = getattr(shared, "persistence", None) if persists else None
        self._episodes = np.zeros(copies, dtype=np.int64)  # numbers from which the persisting errors are derived
        places = copies if self._by_face else 0, self._places
        self._held, self._used = np.full(places, NOTHING_HELD, np.int32), np.zeros(places, np.uint32)
        self.clear_memory()

    def seed(self, seed: int, copy: int = 0) -> None:
        """Restart the random stream of one copy; streams with other tags are independent of it."""
        self.rngs.seed(seed, copy)

    def clear_memory(self, copies: Copies | None = None) -> None:
        """Clear the previous readings of all copies, or of some, at the start of an episode; errors are drawn anew."""
        which = np.arange(self.copies) if copies is None else np.asarray(copies)
        self._episodes[which] = new_episodes(which, self.rngs.keys, self.rngs.counters)
        self.law.clear((which[:, None] * self._places + np.arange(self._places)).ravel())
        if self._by_face:
            self._held[which], self._used[which] = NOTHING_HELD, 0

    def draw(self, copies: Ints, fired: FiredPings) -> Floats:
        """Draw the readings of pings, and return their records, (n, records.N_RECORD); see `records.first_echoes`.

        Args:
            copies: numbers of the copies in `fired.counts`, (r,).
            fired: the pings and their paths.
        """
        index = fired.car * self.count + fired.sonar
        sonars = index[fired.owner]
        places = self._memory_places(fired) if self._by_face else sonars
        source = self._source(copies, fired, sonars)
        drawn = self.law.draw(PathPings(fired.conditions, fired.time, places), source)
        credence = NOTHING if drawn.credence is None else drawn.credence
        fault = NO_FAULTS if drawn.fault is None else drawn.fault
        step = float(self.model.resolution)
        out = records.first_echoes(fired, drawn.range, drawn.status, credence, fault, step, self.max_range)
        self.law.hear(index, out[:, records.RANGE], out[:, records.STATUS])
        return out

    def _source(self, copies: Ints, fired: FiredPings, sonars: Ints) -> PathSource:
        """Return the random numbers of the paths, with the part that persists."""
        stream, held = self.rngs.of(copies, fired.counts, len(fired.owner)), self.persistence
        if held is None:
            return stream
        keys = keys_of(self._episodes, sonars, self.count)
        return PersistentStream(stream, latents(fired.paths, keys, held.lasting, held.length_m), held)

    def _memory_places(self, fired: FiredPings) -> Ints:
        """Return the place in a stateful model's memory of each path, (m,); faces that are new get an empty one."""
        faces, owner = fired.paths[:, columns.FACE].astype(np.int64), fired.owner
        places, new = assign_places(fired.car[owner], fired.sonar[owner], faces, self._held, self._used)
        if new.any():
            self.law.clear(places[new])
        return places

    def credence(self, reading: Reading) -> Floats:
        """Return the credence given each sonar's reading, (copies * count,); 0 without an echo."""
        sonar = np.arange(len(reading)) % self.count
        place = np.minimum(np.searchsorted(self.edges, reading.range, side="right") - 1, BINS - 1)
        return np.where(reading.echo, self.tables[sonar, place], 0.0)
