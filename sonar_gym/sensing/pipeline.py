"""The sensing pipeline: draws the readings of pings, shows them when they arrive, and reports the truth about them.

The environment and the wrappers both use it. They differ only in how the paths of a ping are found: in the environment
from the pose of the car at the firing time, in a wrapper from the observation nearest in time.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from acquisition.arrays import Floats, Ints, Singles
from sonar_gym.sensing import paths as columns
from sonar_gym.sensing import records
from sonar_gym.sensing.records import PingArrays
from sonar_gym.sensing.scene import EMPTY_M
from sonar_gym.sensing.sonar import Sonar

NOTHING = np.empty((0, records.N_RECORD))  # records where no sonar has fired
SONAR_KEYS = ("ranges", "credence", "echo", "age")


class Sensing:
    """Sonars of n cars: their pings, readings and observations.

    Args:
        sonar: sonars, with one copy per car.
        timing: period, phase and latency of each sonar, s, (s, 3).
        step_s: time between observations, s.
        rows: greatest number of cars in an update; None for all.

    Attributes:
        pings: arrays of all cars.
    """

    def __init__(self, sonar: Sonar, timing: Floats, step_s: float, rows: int | None = None) -> None:
        self.sonar, self.timing, self.step_s = sonar, timing, step_s
        self._latency = np.ascontiguousarray(timing[:, 2])
        depth = int(np.floor((timing[:, 2] / timing[:, 0]).max() + records.SAME_TIME_S)) + 2
        self.pings = PingArrays.of(sonar.copies, sonar.count, depth, rows or sonar.copies)

    def begin(self, rows: Ints, pings: PingArrays | None = None) -> None:
        """Begin episodes of some cars: clear memory and pings; their paths are then measured, and `update` called."""
        self.sonar.clear_memory(rows)
        records.clear(rows, self.pings if pings is None else pings)

    def update(self, rows: Ints, now: Floats, pings: PingArrays | None = None) -> None:
        """Draw the readings of the sonars that have fired, and update the observations of some cars.

        Args:
            rows: numbers of the cars, (r,).
            now: times of their observations, s, (r,).
            pings: arrays with what the pings face, by default `self.pings`; another thread has its own.
        """
        p, sonar = self.pings if pings is None else pings, self.sonar
        fired = records.gather(rows, EMPTY_M, p)
        new = fired.car, fired.sonar, sonar.draw(rows, fired) if len(fired.car) else NOTHING
        records.update_observation(*new, rows, now, self._latency, sonar.edges, sonar.tables, sonar.max_range, p)

    # ---- output ------------------------------------------------------------------------------------------------------

    def observation(self, which: int | slice | Ints) -> dict[str, Singles]:
        """Return observations: of one car, each (s,), or of several, each (r, s)."""
        return {name: getattr(self.pings, name)[which].copy() for name in SONAR_KEYS}

    def truth(self, which: int | slice | Ints) -> dict[str, Any]:
        """Return the truth about the pings whose readings are shown, each (s,) or (r, s).

        The distance and the other conditions are those of the face that answered, or else of the face that is detected
        most often; `second` is the range of the second echo, m, 0 without one.
        """
        shown = self.pings.of_shown(which)
        ping = shown.transpose(shown.ndim - 1, *range(shown.ndim - 1)).copy()  # numpy.moveaxis, but faster
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
            "cause": self.pings.cause[which].astype(np.int64),
        }
        if self.sonar.has_credence:
            out["credence_given_condition"] = ping[records.GIVEN_CONDITION]
        return out
