"""When sonars ping and when their readings arrive, from periods, phases and latencies in seconds.

The environment is known only at its observations. A ping sent between two observations is given the conditions of the
earlier one. Its reading is shown from the first observation at or after its arrival until the next reading arrives.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from acquisition import EchoStatus, Ping, Reading, SettingError
from acquisition.arrays import Bits, Floats, Ints, Singles
from sonar_gym.sensing.scene import EMPTY_M
from sonar_gym.sensing.sonar import ECHO_CODE, Sonar

SAME_TIME_S = 1e-9  # s; times closer than this are equal
DISTANCE, BEARING, INCIDENCE, REFLECTANCE, IN_CONE, SENT, RANGE, STATUS, GIVEN_CONDITION = range(9)
N_COLUMNS, N_CONDITIONS = 9, 5  # columns of a ping, and how many of them are its conditions
Times = tuple[ArrayLike, ArrayLike, ArrayLike]  # period, phase and latency, s
MAX_AGE_S = 1.0  # upper limit of the age in an observation


class PingConditions(NamedTuple):
    """Conditions of the pings of s sonars on each of r cars.

    Attributes:
        distance: distance to the nearest reflector, m, (r, s); arbitrary where the cone is empty.
        bearing: bearing of the reflector off the beam axis, rad, (r, s).
        incidence: angle between beam and surface normal, rad, (r, s).
        reflectance: reflectance of the surface, 0..1, (r, s).
        in_cone: whether a reflector is in the cone, (r, s).
    """

    distance: Floats
    bearing: Floats
    incidence: Floats
    reflectance: Floats
    in_cone: Bits


def timing(count: int, step_s: float, times: Times) -> Floats:
    """Return period, phase and latency of each sonar, s, (count, 3).

    Args:
        count: number of sonars.
        step_s: time between observations, s.
        times: period (0 for a ping at every observation), time of the first ping (unused if the period is 0), and
            latency of the reading, s; each is one number or one for each sonar.

    Raises:
        SettingError: a time is negative or not finite, or a period is shorter than `step_s`.
    """
    columns = []
    for name, value_s in zip(("period_s", "phase_s", "latency_s"), times, strict=True):
        value = np.asarray(value_s, dtype=np.float64)
        if value.shape not in ((), (count,)):
            raise SettingError(f"{name} has shape {value.shape}, expected one number or {count}, one for each sonar")
        if not np.all((value >= 0.0) & np.isfinite(value)):
            raise SettingError(f"{name} must be finite and >= 0 s, got {value_s}")
        columns.append(np.broadcast_to(value, count))
    too_short = (columns[0] > 0.0) & (columns[0] < step_s - SAME_TIME_S)
    if too_short.any():
        raise SettingError(
            f"period_s is {columns[0][too_short][0]:g} s, less than the {step_s:g} s from one observation to the next: "
            "give 0 for a ping at every observation"
        )
    return np.stack(columns, axis=1)


class PingSchedule:
    """Draws the readings of the sonars of n cars at their pings and shows them when they arrive.

    Args:
        sonar: sonars, with one copy per car.
        when: period, phase and latency of each sonar, s, (s, 3).
        step_s: time between observations, s.

    Attributes:
        shown: pings whose readings arrived last, in columns `DISTANCE` to `GIVEN_CONDITION`, (n, s, N_COLUMNS).
    """

    def __init__(self, sonar: Sonar, when: Floats, step_s: float) -> None:
        self.sonar, self.step_s = sonar, step_s
        self._period, self._phase, self._latency = when.T
        self._every_step = not (self._period.any() or self._latency.any())
        n, s = sonar.copies, sonar.count
        in_flight = self._latency / np.maximum(self._period, step_s)
        self._depth = int(np.floor(in_flight.max() + SAME_TIME_S)) + 2  # pings in flight, and the latest to arrive
        self._in_flight = np.zeros((n, s, self._depth, N_COLUMNS))
        self._slot = np.zeros((n, s), dtype=np.int64)
        self._before = np.zeros((N_CONDITIONS, n, s))
        self._steps, self._sonars = np.zeros(n, dtype=np.int64), np.arange(s)
        self.shown = np.zeros((n, s, N_COLUMNS))

    def begin(self, rows: Ints, conditions: PingConditions) -> None:
        """Begin episodes of some cars: clear the memory, ping with all sonars, and show their readings at once."""
        self.sonar.clear_memory(rows)
        self._steps[rows] = 0
        self._in_flight[rows, :, :, SENT] = np.inf
        now: Floats = np.stack(conditions)
        self._before[:, rows] = now
        self.shown[rows] = self._measured(rows, now, 0.0)

    def step(self, rows: Ints, conditions: PingConditions) -> None:
        """Advance some cars by one observation."""
        self._steps[rows] += 1
        current: Floats = np.stack(conditions)
        now: Floats = np.asarray(self._steps[rows, None] * self.step_s, dtype=np.float64)
        if self._every_step:
            self.shown[rows] = self._measured(rows, current, now)
            return
        sent_s, fired = self._last_pings(now)
        at_ping = np.where(sent_s < now - SAME_TIME_S, self._before[:, rows], current)
        self._before[:, rows] = current
        if fired.any():
            self._send(rows, fired, self._measured(rows, at_ping, sent_s, fired))
        self._update_shown(rows, now)

    def _last_pings(self, now: Floats) -> tuple[Floats, Bits]:
        """Return the time of each sonar's last ping, s, and whether it was sent since the last observation, (r, s)."""
        period = np.where(self._period > 0.0, self._period, 1.0)
        last = self._phase + np.floor((now - self._phase) / period + SAME_TIME_S) * period
        last = np.where(self._period > 0.0, last, now)
        begun = (self._period == 0.0) | (last >= self._phase - SAME_TIME_S)
        return last, begun & (last > now - self.step_s + SAME_TIME_S)

    def _measured(self, rows: Ints, conditions: Floats, sent_s: ArrayLike, fired: Bits | None = None) -> Floats:
        """Return pings with their readings, (r, s, N_COLUMNS); `fired` selects some of them, None means all."""
        count = self.sonar.count
        out = np.empty((len(rows), count, N_COLUMNS))
        out[..., :N_CONDITIONS], out[..., SENT] = np.moveaxis(conditions, 0, -1), np.asarray(sent_s)
        out[..., GIVEN_CONDITION] = 0.0
        pings, index = out.reshape(-1, N_COLUMNS), (rows[:, None] * count + self._sonars).ravel()
        counts = [count] * len(rows)
        if fired is not None:
            pings, index, counts = out[fired], index[fired.ravel()], fired.sum(axis=1).tolist()
        distance, bearing, incidence, reflectance, in_cone, time = pings[:, : SENT + 1].T
        ping = Ping(np.where(in_cone > 0.0, distance, EMPTY_M), bearing, incidence, reflectance, time, index)
        drawn = self.sonar.draw(ping, rows, counts, index)
        pings[:, RANGE], pings[:, STATUS] = drawn.reading.range, drawn.reading.status
        if drawn.credence_given_condition is not None:
            pings[:, GIVEN_CONDITION] = np.where(in_cone > 0.0, drawn.credence_given_condition, 0.0)
        if fired is not None:
            out[fired] = pings
        return out

    def _send(self, rows: Ints, fired: Bits, pings: Floats) -> None:
        """Store new pings as in flight, in place of the oldest ones."""
        row, sonar = np.nonzero(fired)
        slot = self._slot[rows[row], sonar]
        self._in_flight[rows[row], sonar, slot] = pings[fired]
        self._slot[rows[row], sonar] = (slot + 1) % self._depth

    def _update_shown(self, rows: Ints, now: Floats) -> None:
        """Show the latest pings whose readings have arrived."""
        in_flight = self._in_flight[rows]
        sent_s = in_flight[..., SENT]
        arrived = np.where(sent_s + self._latency[:, None] <= now[..., None] + SAME_TIME_S, sent_s, -np.inf)
        newest = np.argmax(arrived, axis=-1)[..., None]
        latest = np.take_along_axis(arrived, newest, axis=-1)[..., 0]
        received = np.take_along_axis(in_flight, newest[..., None], axis=2)[:, :, 0]
        newer = latest > self.shown[rows][..., SENT]
        self.shown[rows] = np.where(newer[..., None], received, self.shown[rows])

    # ---- output ------------------------------------------------------------------------------------------------------

    def observation(self) -> dict[str, Singles]:
        """Return the observations, each (n, s): `ranges`, `credence`, `echo` and `age` of the readings shown."""
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
        """Return the true conditions of the pings whose readings are shown, each (n, s)."""
        columns = np.moveaxis(self.shown, -1, 0).copy()
        out: dict[str, Any] = {
            "distance": columns[DISTANCE],
            "bearing": columns[BEARING],
            "incidence": columns[INCIDENCE],
            "reflectance": columns[REFLECTANCE],
            "in_cone": columns[IN_CONE] > 0.0,
        }
        if self.sonar.has_credence:
            out["credence_given_condition"] = columns[GIVEN_CONDITION]
        return out
