"""Pings of the sonars of n cars as arrays: what they face, their readings in flight, and the readings shown.

A ping is a record in columns. Its reading is shown from the first observation at or after its arrival until the next
one arrives. Cars are independent, so they can be updated in any order and in several threads. What pings face is
needed within one update only, so it is held for a few cars at a time: row k of it belongs to the k-th car of an update.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from acquisition.arrays import Bits, Bytes, Floats, Ints, Singles
from sonar_gym.compiled import compiled
from sonar_gym.sensing.detection import OWN_ECHO
from sonar_gym.sensing.paths import DISTANCE, MAX_PATHS, N_PATH, OBSTACLE, SHIFT, SOURCE, Y

# Columns of a record: conditions, obstacle, face and point of the path that answered, or of the path detected most
# often, then the reading
N_FACED = Y + 1
SENT, RANGE, STATUS, GIVEN_CONDITION, FAULT, SECOND, BY_CROSSTALK = range(N_FACED, N_FACED + 7)
N_RECORD = N_FACED + 7
SAME_TIME_S = 1e-9  # s; times closer than this are equal
MAX_AGE_S = 1.0  # upper limit of the age in an observation
REARM_M = 0.43  # m; an SRF08 detects a second echo 2.5 ms after the first at the earliest (`Unit.rearm` of the rig)
# Causes of readings, by number; the faults of the model follow
EMPTY, TARGET, EARLY, LATE, GHOST, MISSED, NO_ANSWER, CROSSTALK, FIRST_FAULT = range(9)
CAUSES = ("empty", "target", "early", "late", "ghost", "missed", "no answer", "cross-talk")
_NO_ECHO, _ECHO, _NO_ANSWER = 0, 1, 2  # as acquisition.EchoStatus


class PingArrays(NamedTuple):
    """Pings and readings of n cars with s sonars each, modified at every observation.

    Attributes:
        paths: paths of the pings in an update of r cars, see `paths.cast_paths`, (r, s, MAX_PATHS, N_PATH).
        n_paths: number of these paths, (r, s).
        sent: time of these pings, s, (r, s).
        fired: whether a sonar has pinged since the last observation, (r, s).
        records: records of the last pings, (n, s, d, N_RECORD).
        slot: place of the next record in `records`, (n, s).
        shown: place there of the record whose reading arrived last, (n, s).
        before: pose and time of the last ping, see `crosstalk.add_crosstalk`, (n, s, 4).
        ranges, credence, echo, age: observation of the sonars, (n, s).
        cause: cause of each reading, (n, s).
    """

    paths: Floats
    n_paths: Ints
    sent: Floats
    fired: Bits
    records: Floats
    slot: Ints
    shown: Ints
    before: Floats
    ranges: Singles
    credence: Singles
    echo: Singles
    age: Singles
    cause: Bytes

    @classmethod
    def of(cls, n: int, s: int, depth: int, rows: int) -> PingArrays:
        """Return empty arrays.

        Args:
            n: number of cars.
            s: number of sonars on each.
            depth: greatest number of readings in flight, and one that is shown.
            rows: greatest number of cars in an update.
        """
        observed: dict[str, Any] = {
            name: np.zeros((n, s), np.float32) for name in ("ranges", "credence", "echo", "age")
        }
        return cls(
            **cls.scratch(rows, s),
            records=np.zeros((n, s, depth, N_RECORD)),
            slot=np.zeros((n, s), np.int64),
            shown=np.zeros((n, s), np.int64),
            before=np.full((n, s, 4), -np.inf),
            cause=np.zeros((n, s), np.uint8),
            **observed,
        )

    @staticmethod
    def scratch(rows: int, s: int) -> dict[str, Any]:
        """Return empty arrays of what pings face, by name."""
        return {
            "paths": np.zeros((rows, s, MAX_PATHS, N_PATH)),
            "n_paths": np.ones((rows, s), np.int64),
            "sent": np.zeros((rows, s)),
            "fired": np.zeros((rows, s), np.bool_),
        }

    def for_thread(self) -> PingArrays:
        """Return the same arrays for another thread, with what pings face apart."""
        return self._replace(**self.scratch(*self.n_paths.shape))

    def of_shown(self, which: int | slice | Ints) -> Floats:
        """Return a copy of the records of the readings shown: (s, N_RECORD) of one car, (r, s, N_RECORD) of several."""
        row: int | Ints = which if isinstance(which, int) else np.arange(len(self.records))[which][..., None]
        return self.records[row, np.arange(self.shown.shape[1]), self.shown[which]]


class FiredPings(NamedTuple):
    """The n pings of an update, and their m paths side by side.

    Attributes:
        car, sonar: numbers of car and sonar of each ping, (n,).
        first: number of the first path of each ping, and m, (n + 1,).
        sent: time of each ping, s, (n,).
        counts: number of paths of each car of the update, (r,).
        paths: the paths, (m, N_PATH).
        conditions: distance, bearing, incidence, reflectance of the paths as conditions of a model, (4, m).
        time: time of the ping of each path, s, (m,).
        owner: number of the ping of each path, (m,).
    """

    car: Ints
    sonar: Ints
    first: Ints
    sent: Floats
    counts: Ints
    paths: Floats
    conditions: Floats
    time: Floats
    owner: Ints


@compiled
def firing_delay(begin: float, dt: float, period: float, phase: float) -> float:
    """Return the delay from `begin` to the last ping of a sonar within dt, s, in (0, dt]; -1 if it does not fire.

    Args:
        begin: time in the episode, s.
        dt: duration, s.
        period: time between pings, s.
        phase: time of the first ping, s.
    """
    last = phase + math.floor((begin + dt - phase + SAME_TIME_S) / period) * period
    return min(last - begin, dt) if last > begin + SAME_TIME_S and last >= phase - SAME_TIME_S else -1.0


@compiled
def fire(
    rows: Ints,
    begin: Floats,
    dt: float,
    timing: Floats,
    now: Floats,
    n_now: Ints,
    before: Floats,
    n_before: Ints,
    p: PingArrays,
) -> None:
    """Set the last pings of cars that are known only at their observations, from the state nearest in time.

    Args:
        rows: numbers of the cars, (r,).
        begin: times of their previous observations, s, (r,).
        dt: time between observations, s.
        timing: period, phase and latency of each sonar, s, (s, 3).
        now: paths at this observation, (r, s, MAX_PATHS, N_PATH).
        n_now: number of these paths, (r, s).
        before: paths at the previous observation, (n, s, MAX_PATHS, N_PATH); replaced.
        n_before: number of these paths, (n, s); replaced.
        p: arrays of all cars.
    """  # fmt: skip
    for k in range(rows.shape[0]):
        i = rows[k]
        for s in range(timing.shape[0]):
            delay = firing_delay(begin[k], dt, timing[s, 0], timing[s, 1])
            p.fired[k, s] = delay > 0.0
            if delay > 0.0:
                p.sent[k, s] = begin[k] + delay
                late = delay > 0.5 * dt + SAME_TIME_S
                p.paths[k, s] = now[k, s] if late else before[i, s]
                p.n_paths[k, s] = n_now[k, s] if late else n_before[i, s]
            before[i, s], n_before[i, s] = now[k, s], n_now[k, s]


@compiled
def gather(rows: Ints, empty: float, p: PingArrays) -> FiredPings:
    """Return the pings of some cars that have fired, (r,), with `empty` as the distance of an empty cone, m."""
    cars, sonars = rows.shape[0], p.fired.shape[1]
    counts, n, m = np.zeros(cars, np.int64), 0, 0
    for k in range(cars):
        for s in range(sonars):
            if p.fired[k, s]:
                n, counts[k] = n + 1, counts[k] + p.n_paths[k, s]
        m += counts[k]
    out = FiredPings(
        np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n + 1, np.int64), np.empty(n), counts,
        np.empty((m, N_PATH)), np.empty((4, m)), np.empty(m), np.empty(m, np.int64),
    )  # fmt: skip
    n, m = 0, 0
    for k in range(cars):
        for s in range(sonars):
            if not p.fired[k, s]:
                continue
            out.car[n], out.sonar[n], out.first[n], out.sent[n] = rows[k], s, m, p.sent[k, s]
            for j in range(p.n_paths[k, s]):
                path = p.paths[k, s, j]
                out.paths[m], out.time[m], out.owner[m] = path, p.sent[k, s], n
                for c in range(4):
                    out.conditions[c, m] = path[c]
                if path[OBSTACLE] < 0.0:
                    out.conditions[0, m] = empty
                m += 1
            n += 1
    out.first[n] = m
    return out


@compiled
def counts_as_echo(path: Floats, reading: float, main: bool, faulty: bool, alone: bool) -> bool:
    """Return whether the echo of a path competes: a path but the main one adds echoes of its own reflector alone."""
    own = abs(reading - path[DISTANCE]) <= OWN_ECHO[0] * path[DISTANCE] + OWN_ECHO[1]
    return main or (own and not faulty and not alone)


@compiled
def first_echoes(
    fired: FiredPings, reading: Floats, status: Bytes, credence: Floats, fault: Ints, step: float, max_range: float
) -> Floats:
    """Return the records of pings, (n, N_RECORD): the first echo of the paths of each, and the second.

    The last path of a ping is the one detected most often: its law also holds false alarms and silence, which a sensor
    has once per ping, and faults. Each other path adds an echo of its own reflector, so that a reflector masks another
    only by an echo that is received.

    Args:
        fired: the pings and their paths.
        reading: reading of each path as if it were alone, m, (m,).
        status: its status, (m,).
        credence: credence given the condition of each path, (m,); empty if the model has none.
        fault: number of the fault of each reading, (m,); empty if the model has no faults.
        step: of the sonar's register, m, in which it also reads another's burst.
        max_range: range beyond which an echo is none, m.
    """
    out, echoes = np.zeros((fired.car.shape[0], N_RECORD)), np.empty(MAX_PATHS)
    for n in range(fired.car.shape[0]):
        begin, last, record = fired.first[n], fired.first[n + 1] - 1, out[n]
        faulty = fault.shape[0] > 0 and fault[last] > 0
        alone, nearest, answered, missed = status[last] == _NO_ANSWER or faulty, math.inf, last, 1.0
        faced = False
        for i in range(begin, last + 1):
            own, echo = fired.paths[i], math.inf
            fails = fault.shape[0] > 0 and fault[i] > 0
            if status[i] == _ECHO and counts_as_echo(own, reading[i], i == last, fails, alone):
                echo = reading[i] + (step * round(own[SHIFT] / step) if own[SHIFT] != 0.0 else 0.0)
            # an earlier burst of another sonar may also return before this ping, which then does not listen yet
            echoes[i - begin] = echo if 0.0 < echo <= max_range else math.inf
            if echoes[i - begin] < nearest:
                nearest, answered = echoes[i - begin], i
            faced = faced or (own[OBSTACLE] >= 0.0 and own[SOURCE] == 0.0)
            missed *= 1.0 - (credence[i] if credence.shape[0] > 0 else 0.0)
        second = math.inf
        for i in range(last + 1 - begin):
            if echoes[i] > nearest + REARM_M:
                second = min(second, echoes[i])
        source = fired.paths[answered, SOURCE]
        # the truth about a sonar is its own path, also if it reads another's burst
        record[:N_FACED] = fired.paths[last if source > 0.0 else answered, :N_FACED]
        record[BY_CROSSTALK], record[SENT] = source, fired.sent[n]
        record[SECOND] = 0.0 if math.isinf(second) else second
        record[RANGE] = 0.0 if math.isinf(nearest) else nearest
        record[STATUS] = _ECHO
        if math.isinf(nearest):  # also if the echo comes from beyond the range
            record[STATUS] = _NO_ANSWER if status[last] == _NO_ANSWER else _NO_ECHO
        record[GIVEN_CONDITION] = 1.0 - missed if faced else 0.0
        record[FAULT] = fault[last] if fault.shape[0] > 0 else 0.0
    return out


@compiled
def store(car: Ints, sonar: Ints, new: Floats, p: PingArrays) -> None:
    """Store new records in place of the oldest ones: of the sonars (car, sonar), (m, N_RECORD)."""
    depth = p.records.shape[2]
    for k in range(car.shape[0]):
        i, s = car[k], sonar[k]
        p.records[i, s, p.slot[i, s]] = new[k]
        p.slot[i, s] = (p.slot[i, s] + 1) % depth


@compiled
def clear(rows: Ints, p: PingArrays) -> None:
    """Begin episodes of some cars: nothing is in flight, and all sonars ping now."""
    for k in range(rows.shape[0]):
        i = rows[k]
        p.fired[k], p.sent[k] = True, 0.0
        p.records[i, :, :, SENT], p.before[i] = np.inf, -np.inf


@compiled
def bin_of(range_: float, edges: Floats) -> int:
    """Return the bin of a range in m; the bins have equal widths, and larger ranges are in the last bin."""
    last = edges.shape[0] - 2
    place = min(int((range_ - edges[0]) / (edges[1] - edges[0])), last)
    if range_ < edges[place]:  # the division may be wrong by rounding
        return place - 1
    return place + 1 if place < last and range_ >= edges[place + 1] else place


@compiled
def cause_of(fault: float, status: float, obstacle: float, reading: float, true: float, crosstalk: float = 0.0) -> int:
    """Return the cause of a reading; a right reading is within 10 % of the true distance, as for credence (Esmi 2016).

    Args:
        fault: number of the model's fault that affects the reading, 0 for none.
        status: status of the reading, an `EchoStatus`.
        obstacle: number of the obstacle that answered or could have, -1 for an empty cone.
        reading: reading, m.
        true: distance of that obstacle, m.
        crosstalk: whether the echo is that of another sonar's burst.
    """
    if fault > 0.0:
        return FIRST_FAULT + int(fault) - 1
    if status == _NO_ANSWER:
        return NO_ANSWER
    if status != _ECHO:
        return MISSED if obstacle >= 0.0 else EMPTY
    if crosstalk > 0.0:
        return CROSSTALK
    if obstacle < 0.0:
        return GHOST
    if abs(reading - true) <= 0.1 * true:
        return TARGET
    return EARLY if reading < true else LATE


@compiled
def update_observation(
    car: Ints,
    sonar: Ints,
    new: Floats,
    rows: Ints,
    now: Floats,
    latency: Floats,
    edges: Floats,
    tables: Floats,
    max_range: float,
    p: PingArrays,
) -> None:
    """Store new records, show the readings that have arrived, and write the observations of some cars.

    Args:
        car: numbers of the cars of the new records, (m,).
        sonar: numbers of their sonars, (m,).
        new: the new records, (m, N_RECORD).
        rows: numbers of the cars, (r,).
        now: times of their observations, s, (r,); at 0 the first readings are shown at once.
        latency: latency of each sonar, s, (s,).
        edges: edges of the bins of credence given a reading, m, (b + 1,).
        tables: credence given a reading, one table per sonar, (s, b).
        max_range: maximum range, m.
        p: arrays of all cars.
    """
    store(car, sonar, new, p)
    ranges, credence, echo, age, cause = p.ranges, p.credence, p.echo, p.age, p.cause
    for k in range(rows.shape[0]):
        i = rows[k]
        for s in range(latency.shape[0]):
            latest = -np.inf
            for place in range(p.records.shape[2]):
                sent = p.records[i, s, place, SENT]
                arrived = now[k] == 0.0 or sent + latency[s] <= now[k] + SAME_TIME_S
                if arrived and latest < sent < np.inf:
                    latest, p.shown[i, s] = sent, place
            ping = p.records[i, s, p.shown[i, s]]
            reading, status = ping[RANGE], ping[STATUS]
            ranges[i, s], credence[i, s], echo[i, s] = 1.0, 0.0, -1.0 if status == _NO_ANSWER else 0.0
            if status == _ECHO:
                ranges[i, s], echo[i, s] = min(reading / max_range, 1.0), 1.0
                credence[i, s] = tables[s, bin_of(reading, edges)]
            age[i, s] = min(max(now[k] - ping[SENT], 0.0), MAX_AGE_S)
            cause[i, s] = cause_of(ping[FAULT], status, ping[OBSTACLE], reading, ping[DISTANCE], ping[BY_CROSSTALK])
