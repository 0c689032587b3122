"""The sensing pipeline: draws the readings of pings, shows them when they arrive, and reports the truth about them.

The environment and the wrappers both use it. They differ only in how the paths of a ping are found: in the environment
from the pose of the car at the firing time, in a wrapper from the observation nearest in time.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats, Ints, Singles
from sonar_gym.sensing import paths as columns
from sonar_gym.sensing import records
from sonar_gym.sensing.paths import MAX_PATHS, N_PATH
from sonar_gym.sensing.persistence import latents
from sonar_gym.sensing.records import PingArrays
from sonar_gym.sensing.scene import EMPTY_M
from sonar_gym.sensing.sonar import Sonar

SONAR_KEYS = ("ranges", "credence", "echo", "age")
PathNumbers = np.arange(MAX_PATHS)


class Sensing:
    """Sonars of n cars: their pings, readings and observations.

    Args:
        sonar: sonars, with one copy per car.
        timing: period, phase and latency of each sonar, s, (s, 3).
        step_s: time between observations, s.

    Attributes:
        pings: arrays of all cars.
    """

    def __init__(self, sonar: Sonar, timing: Floats, step_s: float) -> None:
        self.sonar, self.timing, self.step_s = sonar, timing, step_s
        self._latency = np.ascontiguousarray(timing[:, 2])
        depth = int(np.floor((timing[:, 2] / timing[:, 0]).max() + records.SAME_TIME_S)) + 2
        self.pings = PingArrays.of(sonar.copies, sonar.count, depth)
        self._sonars = np.arange(sonar.count)

    def begin(self, rows: Ints) -> None:
        """Begin episodes of some cars: clear memory and pings; their paths are then measured, and `update` called."""
        self.sonar.clear_memory(rows)
        records.clear(rows, self.pings)

    def update(self, rows: Ints, now: Floats) -> None:
        """Draw the readings of the sonars that have fired, and update the observations of some cars.

        Args:
            rows: numbers of the cars, (r,).
            now: times of their observations, s, (r,).
        """
        sonar = self.sonar
        if self.pings.fired[rows].any():
            self._draw(rows)
        records.update_observation(
            rows, now, self._latency, sonar.edges, sonar.tables, sonar.max_range, self.pings
        )  # fmt: skip

    def _draw(self, rows: Ints) -> None:
        p, s = self.pings, self.sonar.count
        fired = p.fired[rows]
        row, sonar = np.nonzero(fired)
        car = rows[row]
        n_paths, sent = p.n_paths[car, sonar], p.sent[car, sonar]
        every = p.paths[car, sonar]
        paths = every[PathNumbers < n_paths[:, None]] if n_paths.max() > 1 else every[:, 0]
        owner = np.repeat(np.arange(len(car)), n_paths)
        first = np.cumsum(n_paths) - n_paths
        counts = np.bincount(row, n_paths, len(rows)).astype(np.int64).tolist()
        in_cone = paths[:, columns.OBSTACLE] >= 0.0
        index = car * s + sonar
        distance, bearing, incidence, reflectance = (np.ascontiguousarray(paths[:, k]) for k in range(4))
        ping = Ping(
            np.where(in_cone, distance, EMPTY_M), bearing, incidence, reflectance, sent[owner], index[owner]
        )  # fmt: skip
        faces = paths[:, columns.FACE].astype(np.int64)
        held = self.sonar.persistence
        latent = None
        if held is not None:
            latent = latents(np.ascontiguousarray(paths), self.sonar.keys(ping.run), held.lasting, held.length_m)
        drawn = self.sonar.draw(ping, rows, counts, index, first, faces, latent, paths[:, columns.SHIFT])
        out = np.zeros((len(car), records.N_RECORD))
        source = paths[drawn.path, columns.SOURCE]
        last = first + n_paths - 1  # the truth about a sonar is its own path, also if it reads another's burst
        out[:, :N_PATH] = paths[np.where(source > 0.0, last, drawn.path)]
        out[:, records.BY_CROSSTALK] = source
        out[:, records.SENT], out[:, records.SECOND] = sent, drawn.second
        out[:, records.RANGE], out[:, records.STATUS] = drawn.reading.range, drawn.reading.status
        if drawn.credence_given_condition is not None:
            out[:, records.GIVEN_CONDITION] = np.where(in_cone[last], drawn.credence_given_condition, 0.0)
        if drawn.fault is not None:
            out[:, records.FAULT] = drawn.fault
        records.store(car, sonar, out, p)

    # ---- output ------------------------------------------------------------------------------------------------------

    def observation(self, which: int | slice | Ints) -> dict[str, Singles]:
        """Return observations: of one car, each (s,), or of several, each (r, s)."""
        return {name: getattr(self.pings, name)[which].copy() for name in SONAR_KEYS}

    def truth(self, which: int | slice | Ints) -> dict[str, Any]:
        """Return the truth about the pings whose readings are shown, each (s,) or (r, s).

        The distance and the other conditions are those of the face that answered, or else of the face that is detected
        most often; `second` is the range of the second echo, m, 0 without one.
        """
        shown = self.pings.shown[which]
        ping = np.moveaxis(shown, -1, 0).copy()
        out = {
            "distance": ping[columns.DISTANCE],
            "bearing": ping[columns.BEARING],
            "incidence": ping[columns.INCIDENCE],
            "reflectance": ping[columns.REFLECTANCE],
            "in_cone": ping[columns.OBSTACLE] >= 0.0,
            "obstacle": ping[columns.OBSTACLE].astype(np.int64),
            "face": ping[columns.FACE].astype(np.int64),
            "second": ping[records.SECOND],
            "sent": ping[records.SENT],
            "cause": self.pings.cause[which].copy(),
        }
        if self.sonar.has_credence:
            out["credence_given_condition"] = ping[records.GIVEN_CONDITION]
        return out
