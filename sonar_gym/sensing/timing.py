"""When sonars ping and when their readings come in: periods, phases and latencies in seconds, on any clock.

An environment is seen at its observations only. A ping sent between two of them meets the world as it was at the first,
and its reading is shown at the first observation that is not before its arrival; until the next, it stays.
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
NOW = 1e-9  # s; two moments as near as this are one
DISTANCE, BEARING, INCIDENCE, REFLECTANCE, SEEN, SENT, RANGE, STATUS, GIVEN_CONDITION = range(9)
COLUMNS, MET = 9, 5  # of a ping, and those of them that say what it met
Times = tuple[ArrayLike, ArrayLike, ArrayLike]  # period, phase and latency, s
OLDEST_S = 1.0  # greatest age in an observation


class Met(NamedTuple):
    """What the cones of r cars meet, s each.

    Attributes:
        distance: m, (r, s); whatever where a cone is empty.
        bearing: of the reflector off the beam axis, rad, (r, s).
        incidence: between beam and surface normal, rad, (r, s).
        reflectance: (r, s).
        seen: whether there is anything in the cone, (r, s).
    """

    distance: Floats
    bearing: Floats
    incidence: Floats
    reflectance: Floats
    seen: Bits


def timing(count: int, step_s: float, times: Times) -> Floats:
    """Return period, phase and latency of each sonar, s, (count, 3).

    Args:
        count: of sonars.
        step_s: from observation to observation.
        times: s, each one number or one for each sonar: from ping to ping, 0 for a ping at every observation; of the
            first ping, unused where the period is 0; from a ping to its reading.
    """
    columns = []
    for name, given in zip(("period_s", "phase_s", "latency_s"), times, strict=True):
        value = np.asarray(given, dtype=np.float64)
        if value.shape not in ((), (count,)):
            raise SettingError(f"{name} has shape {value.shape}, expected one number or {count}, one for each sonar")
        if not np.all((value >= 0.0) & np.isfinite(value)):
            raise SettingError(f"{name} must be finite and >= 0 s, got {given}")
        columns.append(np.broadcast_to(value, count))
    often = (columns[0] > 0.0) & (columns[0] < step_s - NOW)
    if often.any():
        raise SettingError(
            f"period_s is {columns[0][often][0]:g} s, less than the {step_s:g} s from one observation to the next: "
            "give 0 for a ping at each"
        )
    return np.stack(columns, axis=1)


class Listener:
    """What the sonars of n cars say, ping by ping, as it comes in.

    Args:
        sonar: that draws; its copies are the cars.
        when: period, phase and latency of each sonar, s, (s, 3).
        step_s: from observation to observation.
    """

    def __init__(self, sonar: Sonar, when: Floats, step_s: float) -> None:
        self.sonar, self.step_s = sonar, step_s
        self._period, self._phase, self._latency = when.T
        self._always = not (self._period.any() or self._latency.any())
        n, s = sonar.copies, sonar.count
        flying = self._latency / np.maximum(self._period, step_s)
        self._depth = int(np.floor(flying.max() + NOW)) + 2  # pings on their way, and the one that has just come in
        self._flying = np.zeros((n, s, self._depth, COLUMNS))
        self._slot = np.zeros((n, s), dtype=np.int64)
        self._before = np.zeros((MET, n, s))
        self._steps, self._sonars = np.zeros(n, dtype=np.int64), np.arange(s)
        self.shown = np.zeros((n, s, COLUMNS))

    def begin(self, rows: Ints, met: Met) -> None:
        """Begin episodes of some cars: nothing is remembered, all sonars ping, and are heard at once."""
        self.sonar.forget(rows)
        self._steps[rows] = 0
        self._flying[rows, :, :, SENT] = np.inf
        now: Floats = np.stack(met)
        self._before[:, rows] = now
        self.shown[rows] = self._pinged(rows, now, 0.0)

    def step(self, rows: Ints, met: Met) -> None:
        """Go on by one observation with some cars."""
        self._steps[rows] += 1
        world: Floats = np.stack(met)
        now: Floats = np.asarray(self._steps[rows, None] * self.step_s, dtype=np.float64)
        if self._always:
            self.shown[rows] = self._pinged(rows, world, now)
            return
        sent, fired = self._firing(now)
        faced = np.where(sent < now - NOW, self._before[:, rows], world)
        self._before[:, rows] = world
        if fired.any():
            self._send(rows, fired, self._pinged(rows, faced, sent, fired))
        self._show(rows, now)

    def _firing(self, now: Floats) -> tuple[Floats, Bits]:
        """Return when each sonar pinged last by now, s, and whether that was since the observation before, (r, s)."""
        period = np.where(self._period > 0.0, self._period, 1.0)
        last = self._phase + np.floor((now - self._phase) / period + NOW) * period
        last = np.where(self._period > 0.0, last, now)
        begun = (self._period == 0.0) | (last >= self._phase - NOW)
        return last, begun & (last > now - self.step_s + NOW)

    def _pinged(self, rows: Ints, met: Floats, sent: ArrayLike, fired: Bits | None = None) -> Floats:
        """Draw the readings of pings; return all that is known of them, (r, s, COLUMNS); None: all have fired."""
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
        """Put new pings on their way, in the places of those that came in longest ago."""
        row, sonar = np.nonzero(fired)
        slot = self._slot[rows[row], sonar]
        self._flying[rows[row], sonar, slot] = pings[fired]
        self._slot[rows[row], sonar] = (slot + 1) % self._depth

    def _show(self, rows: Ints, now: Floats) -> None:
        """Show the newest pings whose readings have come in."""
        flying = self._flying[rows]
        sent = flying[..., SENT]
        arrived = np.where(sent + self._latency[:, None] <= now[..., None] + NOW, sent, -np.inf)
        newest = np.argmax(arrived, axis=-1)[..., None]
        latest = np.take_along_axis(arrived, newest, axis=-1)[..., 0]
        came = np.take_along_axis(flying, newest[..., None], axis=2)[:, :, 0]
        newer = latest > self.shown[rows][..., SENT]
        self.shown[rows] = np.where(newer[..., None], came, self.shown[rows])

    # ---- what comes out ----------------------------------------------------------------------------------------------

    def observation(self) -> dict[str, NDArray[np.float32]]:
        """Return what agents get, each (n, s): `ranges`, `credence`, `echo` and `age` of the readings shown."""
        n, s = self.sonar.copies, self.sonar.count
        reading = Reading(self.shown[..., RANGE].ravel(), self.shown[..., STATUS].astype(np.uint8).ravel())
        ranges = np.where(reading.status == EchoStatus.ECHO, reading.range / self.sonar.max_range, 1.0)
        age = np.minimum(self._steps[:, None] * self.step_s - self.shown[..., SENT], OLDEST_S)
        return {
            "ranges": np.minimum(ranges, 1.0).astype(np.float32).reshape(n, s),
            "credence": self.sonar.credence(reading).astype(np.float32).reshape(n, s),
            "echo": ECHO_CODE[reading.status].reshape(n, s),
            "age": np.maximum(age, 0.0).astype(np.float32),
        }

    def truth(self) -> dict[str, Any]:
        """Return what agents cannot know of the pings whose readings are shown, each (n, s)."""
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
