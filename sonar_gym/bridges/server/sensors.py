"""The sonars of one client: their random stream and their memory."""

from __future__ import annotations

from typing import Any

import numpy as np

from acquisition import EchoStatus, Ping, Reading
from acquisition.arrays import Floats, Ints
from noise import SonarModel, listener
from noise.learned.inputs import Inputs
from noise.model import StatefulModel, steps
from sonar_gym.bridges.server.protocol import MAX_SENSORS
from sonar_gym.sensing.laws.choose import compiled_law
from sonar_gym.sensing.laws.drawn import PathPings
from sonar_gym.sensing.sonar import broad_table


class Sensors:
    """Sonars with one model.

    Args:
        model: the model.
        max_range: maximum range, m; an echo beyond it is no echo.
        seed: of the random numbers.
    """

    def __init__(self, model: SonarModel, max_range: float, seed: int) -> None:
        self.max_range, self._shared = max_range, model
        self._table = broad_table(model, max_range)
        self.restart(seed)

    def restart(self, seed: int) -> None:
        """Begin anew: with the random numbers of a seed, and no previous readings."""
        self._rng: Any = np.random.default_rng(seed)
        self._model = listener(self._shared)
        self._stateful = self._model if isinstance(self._model, StatefulModel) else None
        self._compiled = compiled_law(self._model, MAX_SENSORS, self.max_range)
        size = MAX_SENSORS if self._model.remembers else 0
        self._range, self._status = np.zeros(size), np.full(size, EchoStatus.NO_ANSWER, dtype=np.uint8)

    def answer(self, ping: Ping) -> tuple[Reading, Floats]:
        """Return the reading of each ping, and its credence given the reading, (n,).

        Args:
            ping: conditions, (n,); `run` is the number of the sensor. Pings of one sensor are in chronological order.
        """
        range_, status = np.zeros(len(ping)), np.zeros(len(ping), np.uint8)
        # of a model with memory, the k-th pings of all sensors are drawn together
        repeats = self._model.remembers and len(set(ping.run.tolist())) < len(ping)
        for rows in steps(ping.run) if repeats else [np.arange(len(ping))]:
            drawn = self._draw(ping[rows]) if len(rows) else Reading.of([])
            range_[rows], status[rows] = drawn.range, drawn.status
        reading = self._in_range(Reading(range_, status))
        return reading, self._table.given(reading)

    def _draw(self, ping: Ping) -> Reading:
        sensor = ping.run
        if self._compiled is not None:
            drawn = self._compiled.draw(PathPings(self._conditions(ping), ping.time, sensor), self._rng)
            return Reading(drawn.range, drawn.status)
        if self._stateful is not None:
            reading = self._stateful.law(ping, self._past(sensor), sensor).sample(self._rng)
        else:
            reading = self._model.law(ping, self._past(sensor)).sample(self._rng)
        if self._model.remembers:
            self._range[sensor], self._status[sensor] = reading.range, reading.status
        return reading

    def _conditions(self, ping: Ping) -> Floats:
        """Return the conditions of pings as rows, with the covariates of the model; NaN for a missing one.

        Compiled laws know the temperatures that they were trained with, and get the equivalent pings.
        """
        inputs: Inputs | None = getattr(self._model, "inputs", None)
        ping = ping if inputs is None else inputs.equivalent(ping)
        missing, names = np.full(len(ping), np.nan), () if inputs is None else inputs.covariates
        more = [ping.covariates.get(name, missing) for name in names]
        return np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, *more])

    def _past(self, sensor: Ints) -> Reading | None:
        if not self._model.remembers:
            return None
        status = self._status[sensor]
        known = self._stateful is not None or np.any(status != EchoStatus.NO_ANSWER)
        return Reading(self._range[sensor], status) if known else None

    def _in_range(self, reading: Reading) -> Reading:
        beyond = reading.range > self.max_range
        status = np.where(beyond, np.uint8(EchoStatus.NO_ECHO), reading.status)
        return Reading(np.where(beyond, 0.0, reading.range), status)
