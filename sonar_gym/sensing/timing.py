"""Schedules of sonars: period, phase and latency in seconds, independent of the step of the environment.

The world is known at the observations only. A ping between two observations faces the world at the first of them. Its
reading is observed from the first observation after its arrival until the next reading arrives.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition import EchoStatus, Ping, Reading, SettingError
from sonar_gym.sensing.scene import EMPTY_M
from sonar_gym.sensing.sonar import ECHO_CODE, Sonar

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bits = NDArray[np.bool_]
TIME_TOLERANCE_S = 1e-9  # s; two moments as near as this are one
DISTANCE, BEARING, INCIDENCE, REFLECTANCE, SEEN, SENT, RANGE, STATUS, GIVEN_CONDITION = range(9)
COLUMNS, MET = 9, 5  # number of columns of a ping, and of those with its condition
Times = tuple[ArrayLike, ArrayLike, ArrayLike]  # period, phase and latency, s
MAX_AGE_S = 1.0  # maximum age in an observation


class ConeConditions(NamedTuple):
    """Conditions in the cones of r cars with s sonars each.

    Attributes:
        distance: m, (r, s); undefined for an empty cone.
        bearing: angle of the reflector off the beam axis, rad, (r, s).
        incidence: angle between beam and surface normal, rad, (r, s).
        reflectance: (r, s).
        seen: whether the cone holds a reflector, (r, s).
    """

    distance: Floats
    bearing: Floats
    incidence: Floats
    reflectance: Floats
    seen: Bits


def timing(count: int, step_s: float, times: Times) -> Floats:
    """Return period, phase and latency of each sonar, s, (count, 3).

    Args:
        count: number of sonars.
        step_s: time between observations, s.
        times: period (0 for a ping at every observation), phase (time of the first ping; unused if the period is 0) and
            latency, s; each one number, or one per sonar.
    """
    columns = []
    for name, given in zip(("period_s", "phase_s", "latency_s"), times, strict=True):
        value = np.asarray(given, dtype=np.float64)
        if value.shape not in ((), (count,)):
            raise SettingError(f"{name} has shape {value.shape}, expected one number or {count} numbers, one per sonar")
        if not np.all((value >= 0.0) & np.isfinite(value)):
            raise SettingError(f"{name} must be finite and >= 0 s, got {given}")
        columns.append(np.broadcast_to(value, count))
    often = (columns[0] > 0.0) & (columns[0] < step_s - TIME_TOLERANCE_S)
    if often.any():
        raise SettingError(
            f"period_s is {columns[0][often][0]:g} s, less than the {step_s:g} s between observations: "
            "use 0 for a ping at every observation"
        )
    return np.stack(columns, axis=1)


class ScheduledSonar:
    """Sonars of n cars that fire on a schedule, and whose readings arrive after a latency.

    Args:
        sonar: the sonars; one copy per car.
        when: period, phase and latency of each sonar, s, (s, 3).
        step_s: time between observations, s.
    """

    def __init__(self, sonar: Sonar, when: Floats, step_s: float) -> None:
        self.sonar, self.step_s = sonar, step_s
        self._period, self._phase, self._latency = when.T
        self._always = not (self._period.any() or self._latency.any())
        n, s = sonar.copies, sonar.count
        last_pings = self._latency / np.maximum(self._period, step_s)
        self._depth = (
            int(np.floor(last_pings.max() + TIME_TOLERANCE_S)) + 2
        )  # pings in flight, and the one that arrived last
        self._in_flight = np.zeros((n, s, self._depth, COLUMNS))
        self._slot = np.zeros((n, s), dtype=np.int64)
        self._before = np.zeros((MET, n, s))
        self._steps, self._sonars = np.zeros(n, dtype=np.int64), np.arange(s)
        self.shown = np.zeros((n, s, COLUMNS))

    def begin(self, rows: Ints, met: ConeConditions) -> None:
        """Begin episodes of some cars: clear previous readings; all sonars fire, and their readings arrive at once."""
        self.sonar.forget(rows)
        self._steps[rows] = 0
        self._in_flight[rows, :, :, SENT] = np.inf
        now: Floats = np.stack(met)
        self._before[:, rows] = now
        self.shown[rows] = self._pinged(rows, now, 0.0)

    def step(self, rows: Ints, met: ConeConditions) -> None:
        """Advance some cars by one observation."""
        self._steps[rows] += 1
        world: Floats = np.stack(met)
        now: Floats = np.asarray(self._steps[rows, None] * self.step_s, dtype=np.float64)
        if self._always:
            self.shown[rows] = self._pinged(rows, world, now)
            return
        sent, fired = self._firing(now)
        faced = np.where(sent < now - TIME_TOLERANCE_S, self._before[:, rows], world)
        self._before[:, rows] = world
        if fired.any():
            self._send(rows, fired, self._pinged(rows, faced, sent, fired))
        self._show(rows, now)

    def _firing(self, now: Floats) -> tuple[Floats, Bits]:
        """Return the time of the last ping of each sonar, s, and whether it is after the last observation, (r, s)."""
        period = np.where(self._period > 0.0, self._period, 1.0)
        last = self._phase + np.floor((now - self._phase) / period + TIME_TOLERANCE_S) * period
        last = np.where(self._period > 0.0, last, now)
        begun = (self._period == 0.0) | (last >= self._phase - TIME_TOLERANCE_S)
        return last, begun & (last > now - self.step_s + TIME_TOLERANCE_S)

    def _pinged(self, rows: Ints, met: Floats, sent: ArrayLike, fired: Bits | None = None) -> Floats:
        """Draw the readings of pings and return all columns, (r, s, COLUMNS); `fired` None means all sonars."""
        count = self.sonar.count
        out = np.empty((len(rows), count, COLUMNS))
        out[..., :MET], out[..., SENT], out[..., GIVEN_CONDITION] = np.moveaxis(met, 0, -1), np.asarray(sent), 0.0
        pings, place = out.reshape(-1, COLUMNS), (rows[:, None] * count + self._sonars).ravel()
        each = [count] * len(rows)
        if fired is not None:
            pings, place, each = out[fired], place[fired.ravel()], fired.sum(axis=1).tolist()
        distance, bearing, incidence, reflectance, seen, moment = pings[:, : SENT + 1].T
        ping = Ping(np.where(seen > 0.0, distance, EMPTY_M), bearing, incidence, reflectance, moment, place)
        drawn = self.sonar.draw(ping, rows, each, place)
        pings[:, RANGE], pings[:, STATUS] = drawn.reading.range, drawn.reading.status
        if drawn.credence_given_condition is not None:
            pings[:, GIVEN_CONDITION] = np.where(seen > 0.0, drawn.credence_given_condition, 0.0)
        if fired is not None:
            out[fired] = pings
        return out

    def _send(self, rows: Ints, fired: Bits, pings: Floats) -> None:
        """Store new pings in the slots of the oldest."""
        row, sonar = np.nonzero(fired)
        slot = self._slot[rows[row], sonar]
        self._in_flight[rows[row], sonar, slot] = pings[fired]
        self._slot[rows[row], sonar] = (slot + 1) % self._depth

    def _show(self, rows: Ints, now: Floats) -> None:
        """Observe the newest pings whose readings have arrived."""
        last_pings = self._in_flight[rows]
        sent = last_pings[..., SENT]
        arrived = np.where(sent + self._latency[:, None] <= now[..., None] + TIME_TOLERANCE_S, sent, -np.inf)
        newest = np.argmax(arrived, axis=-1)[..., None]
        latest = np.take_along_axis(arrived, newest, axis=-1)[..., 0]
        came = np.take_along_axis(last_pings, newest[..., None], axis=2)[:, :, 0]
        newer = latest > self.shown[rows][..., SENT]
        self.shown[rows] = np.where(newer[..., None], came, self.shown[rows])

    # ---- results -----------------------------------------------------------------------------------------------------

    def observation(self) -> dict[str, NDArray[np.float32]]:
        """Return the observations, each (n, s): `ranges`, `credence`, `echo` and `age`."""
        n, s = self.sonar.copies, self.sonar.count
        reading = Reading(self.shown[..., RANGE].ravel(), self.shown[..., STATUS].astype(np.uint8).ravel())
        ranges = np.where(reading.status == EchoStatus.ECHO, reading.range / self.sonar.max_range, 1.0)
        age = np.minimum(self._steps[:, None] * self.step_s - self.shown[..., SENT], MAX_AGE_S)
        return {
            "ranges": np.minimum(ranges, 1.0).astype(np.float32).reshape(n, s),
            "credence": self.sonar.credence(reading).astype(np.float32).reshape(n, s),
            "echo": ECHO_CODE[reading.status].reshape(n, s),
            "age": np.maximum(age, 0.0).astype(np.float32),
        }

    def truth(self) -> dict[str, Any]:
        """Return the true conditions of the pings behind the observed readings, each (n, s)."""
        columns = np.moveaxis(self.shown, -1, 0).copy()
        out: dict[str, Any] = {
            "distance": columns[DISTANCE],
            "bearing": columns[BEARING],
            "incidence": columns[INCIDENCE],
            "reflectance": columns[REFLECTANCE],
            "in_cone": columns[SEEN] > 0.0,
        }
        if self.sonar.has_credence:
            out["credence_given_condition"] = columns[GIVEN_CONDITION]
        return out
