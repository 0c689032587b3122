"""The step of all forms of the environment, compiled by numba: many cars, each in its own street.

World i is row i of every array. Rows are independent, so they can be stepped in any order and by several threads.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonar_gym.compiled import compiled
from sonar_gym.sensing.kernels import NOTHING, Floats, Ints, cast_cone, drive_part, out_of_frame, roll
from sonar_gym.sensing.odometry import PULL, SCALE, integrate

Bits = NDArray[np.bool_]
Singles = NDArray[np.float32]
DISTANCE, BEARING, INCIDENCE, REFLECTANCE, OBJECT, X, Y, SENT, RANGE, STATUS, GIVEN_CONDITION, FAULT = range(12)
COLUMNS = 12
GAP, GAP_END, LINE, GOAL_X, GOAL_Y, TURN, READY_X, COST = range(8)
TASK = 8
PARKED, COLLISION, LEFT_STREET = range(3)
PARTS = 5  # parts of a step; collisions are checked at the end of each
TIME_TOLERANCE_S = 1e-9  # two times that differ by less are equal
# Causes of readings, by number; the faults of a model are numbered from FAULTS on
EMPTY, TARGET, EARLY, LATE, GHOST, MISSED, NO_ANSWER, FAULTS = range(8)
CAUSES = ("empty", "target", "early", "late", "ghost", "missed", "no answer")
_ECHO, _NO_ANSWER = 1, 2  # members of acquisition.EchoStatus


class Worlds(NamedTuple):
    """State of the worlds, written by a step.

    Attributes:
        steps: number of steps since the start of the episode, (n,).
        car: x, y, heading, speed, steering angle, (n, 5).
        odometry: state of the odometer, see `odometry.integrate`, (n, 7).
        task: x of the two ends of the gap, m; y of the line of the strip, m; x and y of the end of the reference path,
            m; angle of its two arcs, rad; x at which they begin, m; cost to go, m; columns `GAP` to `COST`, (n, TASK).
        counts: number of segments, (n,).
        segments: m, (n, m, 4).
        surface: reflectance and texture of each segment, 1 and rad, (n, m, 2).
        owner: index of the object of each segment, (n, m).
        last_pings: the last ping of each sonar: its condition, time and reading, columns `DISTANCE` to `FAULT`,
            (n, s, COLUMNS).
        fired: whether that ping is new, (n, s).
        in_flight: whether its reading has not arrived yet, (n, s).
        observed: the pings of the readings that arrived last, (n, s, COLUMNS).
        terms: reward terms: progress, time, parked, crashed, (n, 4).
        ended: parked, collision, left the street, (n, 3).
        ranges, credence, echo, age: observations of the sonars, (n, s).
        ego: observation of the car, (n, 7).
        cause: cause of each reading, (n, s).
    """

    steps: Ints
    car: Floats
    odometry: Floats
    task: Floats
    counts: Ints
    segments: Floats
    surface: Floats
    owner: Ints
    last_pings: Floats
    fired: Bits
    in_flight: Bits
    observed: Floats
    terms: Floats
    ended: Bits
    ranges: Singles
    credence: Singles
    echo: Singles
    age: Singles
    ego: Singles
    cause: Ints


class StepConstants(NamedTuple):
    """Constants shared by all worlds.

    Attributes:
        measures: dynamics of the car, see `CarSettings.dynamics`.
        body: rectangle of the car, (4,).
        mounts: poses of the sonars in the frame of the car, (s, 3).
        half: half opening angles, rad, (s,).
        timing: period, phase, latency of each sonar, s, (s, 3).
        arc: arc of the reference path, see `cost_to_go`.
        weights: reward weights, in the order of `RewardWeights`.
        share: scales of `ego`: speed, steering, odometry along and across, steps, (5,).
        limits: limits of `is_parked`: speed, m/s, angle, rad, overhang, m; x of the open end of the street, m.
        edges, tables: credence given a reading, one table per sonar, (b + 1,), (s, b).
        dt: duration of a step, s.
        far: maximum range, m.
    """

    measures: Floats
    body: Floats
    mounts: Floats
    half: Floats
    timing: Floats
    arc: Floats
    weights: Floats
    share: Floats
    limits: Floats
    edges: Floats
    tables: Floats
    dt: float
    far: float


@compiled
def firing(begin: float, dt: float, period: float, phase: float) -> float:
    """Return the delay from `begin` to the last ping of a sonar within a step, s, in (0, dt]; -1 without a ping.

    Args:
        begin: time since the start of the episode, s.
        dt: duration of the step, s.
        period: interval between pings, s; 0 for one ping at the end of every step.
        phase: time of the first ping, s.
    """
    if period <= 0.0:
        return dt
    last = phase + math.floor((begin + dt - phase + TIME_TOLERANCE_S) / period) * period
    return min(last - begin, dt) if last > begin + TIME_TOLERANCE_S and last >= phase - TIME_TOLERANCE_S else -1.0


@compiled
def cost_to_go(pose: Floats, task: Floats, arc: Floats, per_metre: float, per_radian: float) -> float:
    """Return the minimum over the reference path of remaining path length plus the cost of the offset from the path.

    The path follows the lane, then two equal arcs backwards. Along the lane the minimum has a closed form (the law of
    refraction). On the arcs, poses 1 cm apart are compared.

    Args:
        pose: x, y, heading, (3,).
        task: task of this world.
        arc: rows of angle, displacement in x and in y, arc length: rad, m, m, m, increasing from 0, (k, 4).
        per_metre: cost of a lateral distance of 1 m, m.
        per_radian: cost of a heading error of 1 rad, m.
    """
    radius = arc[-1, 3] / arc[-1, 0]
    half_way = radius * task[TURN]
    ahead = abs(pose[1]) / math.sqrt(per_metre * per_metre - 1.0) if per_metre > 1.0 else math.inf
    lane_x = min(pose[0] + ahead, task[READY_X])
    off = per_metre * math.hypot(pose[0] - lane_x, pose[1])
    best = 2.0 * half_way + task[READY_X] - lane_x + off + per_radian * abs(pose[2])
    for second in (True, False):
        for k in range(arc.shape[0]):
            left = arc[k, 3] if second else 2.0 * half_way - arc[k, 3]
            if arc[k, 0] > task[TURN]:
                break
            if left >= best:
                continue
            x = task[GOAL_X] + arc[k, 1] if second else task[READY_X] - arc[k, 1]
            y = task[GOAL_Y] + arc[k, 2] if second else -arc[k, 2]
            cost = left + per_metre * math.sqrt((pose[0] - x) ** 2 + (pose[1] - y) ** 2)
            if cost < best:
                turn = abs((pose[2] - arc[k, 0] + math.pi) % (2.0 * math.pi) - math.pi)
                best = min(best, cost + per_radian * turn)
    return best


@compiled
def is_parked(state: Floats, body: Floats, task: Floats, limits: Floats) -> bool:
    """Return whether a car is parked: slow, parallel to the kerb, and with every corner inside the gap."""
    if abs(state[3]) > limits[0] or abs(state[2]) > limits[1]:
        return False
    for x, y in ((body[0], body[1]), (body[0], body[3]), (body[2], body[1]), (body[2], body[3])):
        at_x, at_y = out_of_frame(x, y, state)
        if not task[GAP] <= at_x <= task[GAP_END] or at_y > task[LINE] + limits[2]:
            return False
    return True


# The functions below unpack named tuples once per call: each access counts references, which costs more than the work.


@compiled
def cast_ping(
    last_pings: Floats,
    i: int,
    s: int,
    pose: tuple[float, float, float],
    sent: float,
    mounts: Floats,
    half: Floats,
    segments: Floats,
    surface: Floats,
    owner: Ints,
    far: float,
) -> None:
    """Cast the cone of sonar s of world i from a pose of the car, and write the condition (see `Hits`)."""
    c, sn = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + c * mounts[s, 0] - sn * mounts[s, 1], pose[1] + sn * mounts[s, 0] + c * mounts[s, 1]
    away, bearing, met, face, at_x, at_y = cast_cone(x, y, pose[2] + mounts[s, 2], half[s], segments, far)
    last_pings[i, s, DISTANCE], last_pings[i, s, BEARING], last_pings[i, s, SENT] = away, bearing, sent
    last_pings[i, s, X], last_pings[i, s, Y] = at_x, at_y
    last_pings[i, s, INCIDENCE], last_pings[i, s, REFLECTANCE], last_pings[i, s, OBJECT] = 0.0, 0.0, NOTHING
    if face != NOTHING:
        last_pings[i, s, INCIDENCE] = max(met - surface[i, face, 1], 0.0)
        last_pings[i, s, REFLECTANCE], last_pings[i, s, OBJECT] = surface[i, face, 0], owner[i, face]


@compiled
def deliver(last_pings: Floats, in_flight: Bits, observed: Floats, i: int, s: int, now: float, latency: float) -> None:
    """Observe the reading of a ping if it has arrived. At the start of an episode all readings have arrived."""
    if in_flight[i, s] and (now == 0.0 or now + TIME_TOLERANCE_S >= last_pings[i, s, SENT] + latency):
        in_flight[i, s] = False
        for k in range(COLUMNS):
            observed[i, s, k] = last_pings[i, s, k]


@compiled
def write_ego(ego: Singles, car: Floats, odometry: Floats, i: int, share: Floats, wheelbase: float, step: int) -> None:
    """Write speed, steering, odometry and time to `ego`, all with the errors of the odometer."""
    x, y, turn, pull = odometry[i, 0], odometry[i, 1], odometry[i, 2], odometry[i, PULL]
    speed, steering = car[i, 3] * (1.0 + odometry[i, SCALE]), car[i, 4]
    if pull != 0.0:  # an offset of the steering sensor: straight motion is measured as a curve
        steering = math.atan(math.tan(steering) + pull * wheelbase)
    shares = (speed / share[0], steering / share[1])
    values = (*shares, math.cos(turn), math.sin(turn), x / share[2], y / share[3], step / share[4])
    for k in range(7):
        ego[i, k] = min(max(values[k], -1.0), 1.0)


@compiled
def write_reward(terms: Floats, car: Floats, task: Floats, ended: Bits, i: int, arc: Floats, weights: Floats) -> None:
    """Write the reward terms and the new cost to go."""
    cost = cost_to_go(car[i, :3], task[i], arc, weights[4], weights[5])
    terms[i, 0], terms[i, 1] = weights[0] * (task[i, COST] - cost), weights[1]
    terms[i, 2] = weights[2] if ended[i, PARKED] else 0.0
    terms[i, 3] = weights[3] if ended[i, COLLISION] or ended[i, LEFT_STREET] else 0.0
    task[i, COST] = cost


@compiled
def begin(rows: Ints, w: Worlds, r: StepConstants) -> None:
    """Begin episodes in worlds whose street and car are set: all sonars fire, and all other state is reset."""
    last_pings, car, surface, owner, mounts, half = w.last_pings, w.car, w.surface, w.owner, r.mounts, r.half
    for i in rows:
        w.steps[i] = 0
        pose, segments = (car[i, 0], car[i, 1], car[i, 2]), w.segments[i, : w.counts[i]]
        for s in range(half.shape[0]):
            cast_ping(last_pings, i, s, pose, 0.0, mounts, half, segments, surface, owner, r.far)
        w.fired[i], w.in_flight[i], w.ended[i] = True, False, False
        write_reward(w.terms, car, w.task, w.ended, i, r.arc, r.weights)
        w.terms[i] = 0.0
        write_ego(w.ego, car, w.odometry, i, r.share, r.measures[0], 0)


@compiled
def advance(rows: Ints, wanted: Floats, w: Worlds, r: StepConstants) -> None:
    """Drive the cars of some worlds for one step. Each sonar fires from the pose that the car has at that time.

    Args:
        rows: worlds.
        wanted: commanded steering and speed as fractions of their maximum, one row per world of `rows`, (k, 2).
        w: state of the worlds.
        r: constants.
    """
    steps, car, task, counts, faces, surface, owner = w.steps, w.car, w.task, w.counts, w.segments, w.surface, w.owner
    last_pings, fired, in_flight, observed = w.last_pings, w.fired, w.in_flight, w.observed
    terms, ended, ego, odometry = w.terms, w.ended, w.ego, w.odometry
    measures, body, mounts, half, timing = r.measures, r.body, r.mounts, r.half, r.timing
    arc, weights, share, limits, dt, far = r.arc, r.weights, r.share, r.limits, r.dt, r.far
    h, start, before, due = dt / PARTS, np.empty(3), np.empty(3), np.empty(half.shape[0])
    for k in range(rows.shape[0]):
        i = rows[k]
        begun, hit, segments, state = steps[i] * dt, NOTHING, faces[i, : counts[i]], car[i]
        steps[i] += 1
        start[0], start[1], start[2] = state[0], state[1], state[2]
        for s in range(half.shape[0]):
            due[s] = firing(begun, dt, timing[s, 0], timing[s, 1])
            fired[i, s] = due[s] > 0.0
            deliver(
                last_pings, in_flight, observed, i, s, begun + dt, timing[s, 2]
            )  # before the ping is replaced by a new one
        for part in range(PARTS):
            before[0], before[1], before[2] = state[0], state[1], state[2]
            steering, speed = wanted[k, 0] * measures[5], wanted[k, 1] * measures[6]
            hit, curvature = drive_part(state, steering, speed, measures, body, segments, h)
            last = part == PARTS - 1 or hit != NOTHING
            for s in range(half.shape[0]):
                since = due[s] - part * h
                if due[s] > 0.0 and since > 0.0 and (last or since <= h):
                    there = since >= h - TIME_TOLERANCE_S  # at the end of the part, or later if the car was stopped
                    pose = (state[0], state[1], state[2]) if there else roll(before, state[3] * since, curvature)
                    cast_ping(last_pings, i, s, pose, begun + due[s], mounts, half, segments, surface, owner, far)
            if last:
                break
        if hit != NOTHING:
            state[3] = 0.0
        ended[i, COLLISION], ended[i, LEFT_STREET] = hit != NOTHING, state[0] < limits[3]
        ended[i, PARKED] = hit == NOTHING and is_parked(state, body, task[i], limits)
        integrate(odometry[i], start, state[:3])
        write_reward(terms, car, task, ended, i, arc, weights)
        write_ego(ego, car, odometry, i, share, measures[0], steps[i])


@compiled
def bin_of(range_: float, edges: Floats) -> int:
    """Return the bin of a range in m. Bins have equal width; ranges beyond the last bin belong to it."""
    last = edges.shape[0] - 2
    place = min(int((range_ - edges[0]) / (edges[1] - edges[0])), last)
    if range_ < edges[place]:  # rounding error of the division
        return place - 1
    return place + 1 if place < last and range_ >= edges[place + 1] else place


@compiled
def cause_of(fault: float, status: float, object_index: float, range_: float, true: float) -> int:
    """Return the cause of a reading. A reading within 10 % of the distance is correct, as for credence (Esmi 2016).

    Args:
        fault: number of the fault of the model behind the reading, 0 for none.
        status: `EchoStatus` of the reading.
        object_index: object in the cone, -1 for none.
        range_: reading, m.
        true: distance, m.
    """
    if fault > 0.0:
        return FAULTS + int(fault) - 1
    if status == _NO_ANSWER:
        return NO_ANSWER
    if status != _ECHO:
        return MISSED if object_index >= 0.0 else EMPTY
    if object_index < 0.0:
        return GHOST
    if abs(range_ - true) <= 0.1 * true:
        return TARGET
    return EARLY if range_ < true else LATE


@compiled
def observe(rows: Ints, w: Worlds, r: StepConstants) -> None:
    """Write the observations of the readings that have arrived in some worlds.

    A reading arrives one latency after its ping and is observed until the next one arrives. Each sonar has at most one
    ping in flight.
    """
    last_pings, observed, fired, in_flight, steps = w.last_pings, w.observed, w.fired, w.in_flight, w.steps
    ranges, credence, echo, age, cause = w.ranges, w.credence, w.echo, w.age, w.cause
    timing, edges, tables, dt, far = r.timing, r.edges, r.tables, r.dt, r.far
    for i in rows:
        now = steps[i] * dt
        for s in range(timing.shape[0]):
            in_flight[i, s] |= fired[i, s]
            deliver(last_pings, in_flight, observed, i, s, now, timing[s, 2])
            range_, status = observed[i, s, RANGE], observed[i, s, STATUS]
            ranges[i, s], credence[i, s], echo[i, s] = 1.0, 0.0, -1.0 if status == _NO_ANSWER else 0.0
            if status == _ECHO:
                ranges[i, s], echo[i, s] = min(range_ / far, 1.0), 1.0
                credence[i, s] = tables[s, bin_of(range_, edges)]
            age[i, s] = min(max(now - observed[i, s, SENT], 0.0), 1.0)
            fault, object_index, true = observed[i, s, FAULT], observed[i, s, OBJECT], observed[i, s, DISTANCE]
            cause[i, s] = cause_of(fault, status, object_index, range_, true)
