"""Any sonar model by its `EchoLaw`: physical, faulty, composed, the waveform rig, and models of a user."""

from __future__ import annotations

from typing import Any

import numpy as np

from acquisition import EchoStatus, Ping, Reading
from acquisition.arrays import Floats, Ints
from noise import EchoLaw, SonarModel
from noise.faults import FaultyLaw
from noise.law import UniformSource
from noise.model import StatefulModel
from sonar_gym.sensing.laws.drawn import PathDraws, PathLaw, PathPings, PathSource


class GeneralLaw(PathLaw):
    """The law of any model.

    Args:
        model: model for this set of sonars; a stateful one remembers each face by itself.
        places: number of places in its memory.
        max_range: range beyond which an echo is none, m.
    """

    def __init__(self, model: SonarModel, places: int, max_range: float) -> None:
        self._model, self._max_range = model, max_range
        # checked once: isinstance with a protocol is slow
        self._stateful = model if isinstance(model, StatefulModel) else None
        self._past = np.zeros(places), np.full(places, EchoStatus.NO_ANSWER, dtype=np.uint8)
        first = Ping.of(distance=[1.0])
        if self._stateful is None:
            law = model.law(first, None)
        else:  # makes room for all places, which several threads must not do at once
            law = self._stateful.law(first, None, np.array([places - 1]))
        self.batched, self.has_probabilities = law.uniform_per_ping, law.has_probabilities

    def draw(self, pings: PathPings, source: PathSource) -> PathDraws:
        """Draw the readings of m paths, copy by copy if the law cannot be sampled from several streams at once."""
        distance, angle, incidence, reflectance = pings.conditions
        ping = Ping(distance, angle, incidence, reflectance, pings.time, pings.places)
        past = self._previous(pings.places) if self._model.remembers else None
        if self.batched:
            drawn = self._sample(ping, past, source)
        else:
            drawn = _joined([self._sample(ping[rows], _part(past, rows), rng) for rows, rng in source.parts()])
        if self._stateful is not None:
            self._past[0][pings.places], self._past[1][pings.places] = drawn.range, drawn.status
        return drawn

    def _sample(self, ping: Ping, past: Reading | None, source: UniformSource) -> PathDraws:
        law = self._law(ping, past)
        reading, fault = law.draw(source) if isinstance(law, FaultyLaw) else (law.sample(source), None)
        beyond = reading.range > self._max_range
        status = np.where(beyond, np.uint8(EchoStatus.NO_ECHO), reading.status)
        credence = law.credence() if law.has_probabilities else None
        return PathDraws(np.where(beyond, 0.0, reading.range), status, credence, fault)

    def _law(self, ping: Ping, past: Reading | None) -> EchoLaw:
        if self._stateful is None:
            return self._model.law(ping, past)
        return self._stateful.law(ping, past, ping.run)

    def _previous(self, places: Ints) -> Reading | None:
        """Return the previous readings; None if there are none and the model keeps no state of its own."""
        status = self._past[1][places]
        if self._stateful is not None or np.any(status != EchoStatus.NO_ANSWER):
            return Reading(self._past[0][places], status)
        return None

    def clear(self, places: Ints) -> None:
        """Clear the memory at some places."""
        self._past[0][places], self._past[1][places] = 0.0, EchoStatus.NO_ANSWER
        if self._stateful is not None:
            self._stateful.reset(places)

    def hear(self, sonars: Ints, range_: Floats, status: Floats) -> None:
        """Note the readings of some sonars; a model with a state of its own has noted those of the faces."""
        if self._stateful is None and self._model.remembers:
            self._past[0][sonars], self._past[1][sonars] = range_, status.astype(np.uint8)


def _part(past: Reading | None, rows: slice) -> Reading | None:
    return None if past is None else past[rows]


def _joined(parts: list[PathDraws]) -> PathDraws:
    columns: Any = zip(*parts, strict=True)
    joined: Any = [None if column[0] is None else np.concatenate(column) for column in columns]
    return PathDraws(*joined)
