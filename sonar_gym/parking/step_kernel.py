"""One step of many cars, each on its own street, compiled by numba; all forms of the environment use it.

World i is row i of every array. Rows are independent, so they can be stepped in any order and in several threads.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from acquisition.arrays import Bits, Floats, Ints, Singles
from sonar_gym.compiled import compiled
from sonar_gym.sensing.kernels import NO_HIT, cast_cone, drive_part, out_of_frame, roll
from sonar_gym.sensing.odometry import PULL, SCALE, update_odometry

Floats32 = Singles
DISTANCE, BEARING, INCIDENCE, REFLECTANCE, OBSTACLE, X, Y, SENT, RANGE, STATUS, GIVEN_CONDITION, FAULT = range(12)
N_COLUMNS = 12
GAP, GAP_END, LINE, GOAL_X, GOAL_Y, TURN, READY_X, COST = range(8)
N_TASK = 8
PARKED, COLLISION, LEFT_STREET = range(3)
PARTS = 5  # parts of a step; contact is tested at the end of each
SAME_TIME_S = 1e-9  # s; times closer than this are equal
# Causes of readings, by number; the faults of the model follow
EMPTY, TARGET, EARLY, LATE, GHOST, MISSED, NO_ANSWER, FIRST_FAULT = range(8)
CAUSES = ("empty", "target", "early", "late", "ghost", "missed", "no answer")
_ECHO, _NO_ANSWER = 1, 2  # as acquisition.EchoStatus


class WorldArrays(NamedTuple):
    """State of n worlds with s sonars each, modified by a step.

    Attributes:
        steps: number of steps in the episode, (n,).
        car: x, y, heading, speed, steering angle: m, m, rad, m/s, rad, (n, 5).
        odometry: state of the odometry, see `odometry.update_odometry`, (n, 7).
        task: begin and end of the gap, m; y of the strip's line, m; x and y of the end of the reference path, m; angle
            of its two arcs, rad; x at which they begin, m; cost to go, m; in columns `GAP` to `COST`, (n, N_TASK).
        counts: number of segments, (n,).
        segments: segments, m, (n, m, 4).
        surface: reflectance and slope of the facets of each segment, 1 and rad, (n, m, 2).
        owner: number of the obstacle of each segment, (n, m).
        last_ping: last ping of each sonar: conditions, time, reading; in columns `DISTANCE` to `FAULT`, (n, s,
            N_COLUMNS).
        fired: whether that ping was sent in this step, (n, s).
        in_flight: whether its reading has not arrived yet, (n, s).
        shown: pings whose readings arrived last, (n, s, N_COLUMNS).
        terms: terms of the reward: progress, time, parked, crashed, (n, 4).
        ended: parked, collision, left the street, (n, 3).
        ranges, credence, echo, age: observation of the sonars, (n, s).
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
    last_ping: Floats
    fired: Bits
    in_flight: Bits
    shown: Floats
    terms: Floats
    ended: Bits
    ranges: Floats32
    credence: Floats32
    echo: Floats32
    age: Floats32
    ego: Floats32
    cause: Ints


class StepConstants(NamedTuple):
    """Quantities that are equal in all worlds.

    Attributes:
        dynamics: `CarSettings.dynamics`, (7,).
        body: rectangle of the car, (4,).
        mounts: poses of the sonars in the frame of the car, (s, 3).
        half_angles: half opening angles, rad, (s,).
        timing: period, phase and latency of each sonar, s, (s, 3).
        arc: arc of the reference path, see `cost_to_go`.
        weights: weights of the reward, in the order of `RewardWeights`.
        scale: scales of `ego`: speed, steering angle, distance along, distance across, steps, (5,).
        limits: limits of `is_parked`: speed, m/s, angle, rad, overhang, m; x of the open end of the street, m.
        edges, tables: credence given a reading, one table per sonar, (b + 1,), (s, b).
        dt: duration of a step, s.
        max_range: maximum range, m.
    """

    dynamics: Floats
    body: Floats
    mounts: Floats
    half_angles: Floats
    timing: Floats
    arc: Floats
    weights: Floats
    scale: Floats
    limits: Floats
    edges: Floats
    tables: Floats
    dt: float
    max_range: float


@compiled
def firing_delay(begin: float, dt: float, period: float, phase: float) -> float:
    """Return the delay from `begin` to the last ping of a sonar within dt, s, in (0, dt]; -1 if it does not fire.

    Args:
        begin: time in the episode, s.
        dt: duration, s.
        period: time between pings, s; 0 for one ping at the end of every dt.
        phase: time of the first ping, s.
    """
    if period <= 0.0:
        return dt
    last = phase + math.floor((begin + dt - phase + SAME_TIME_S) / period) * period
    return min(last - begin, dt) if last > begin + SAME_TIME_S and last >= phase - SAME_TIME_S else -1.0


@compiled
def cost_to_go(pose: Floats, task: Floats, arc: Floats, per_metre: float, per_radian: float) -> float:
    """Return the minimum over the reference path of the remaining length plus the cost of the deviation from the path.

    The path follows the lane, then two equal arcs backwards. On the lane the minimum has a closed form, as in
    refraction of
    light: distances to the path and along it have different costs. On the arcs, poses at intervals of 1 cm are
        compared.

    Args:
        pose: pose of the car, (3,).
        task: row of `WorldArrays.task`.
        arc: angle, distance along x, distance along y, arc length: rad, m, m, m, from 0 on, (k, 4).
        per_metre: cost of a deviation of 1 m from the path, m.
        per_radian: cost of a deviation of 1 rad from its heading, m.
    """
    radius = arc[-1, 3] / arc[-1, 0]
    arc_length = radius * task[TURN]
    ahead = abs(pose[1]) / math.sqrt(per_metre * per_metre - 1.0) if per_metre > 1.0 else math.inf
    lane_x = min(pose[0] + ahead, task[READY_X])
    deviation_cost = per_metre * math.hypot(pose[0] - lane_x, pose[1])
    best = 2.0 * arc_length + task[READY_X] - lane_x + deviation_cost + per_radian * abs(pose[2])
    for second in (True, False):
        for k in range(arc.shape[0]):
            remaining = arc[k, 3] if second else 2.0 * arc_length - arc[k, 3]
            if arc[k, 0] > task[TURN]:
                break
            if remaining >= best:
                continue
            x = task[GOAL_X] + arc[k, 1] if second else task[READY_X] - arc[k, 1]
            y = task[GOAL_Y] + arc[k, 2] if second else -arc[k, 2]
            cost = remaining + per_metre * math.sqrt((pose[0] - x) ** 2 + (pose[1] - y) ** 2)
            if cost < best:
                turn = abs((pose[2] - arc[k, 0] + math.pi) % (2.0 * math.pi) - math.pi)
                best = min(best, cost + per_radian * turn)
    return best


@compiled
def is_parked(state: Floats, body: Floats, task: Floats, limits: Floats) -> bool:
    """Return whether a car stands in the gap: slow, parallel to the kerb, and with no corner outside."""
    if abs(state[3]) > limits[0] or abs(state[2]) > limits[1]:
        return False
    for x, y in ((body[0], body[1]), (body[0], body[3]), (body[2], body[1]), (body[2], body[3])):
        at_x, at_y = out_of_frame(x, y, state)
        if not task[GAP] <= at_x <= task[GAP_END] or at_y > task[LINE] + limits[2]:
            return False
    return True


# The kernels below unpack the named tuples once: each access counts references, which costs more than the work.


@compiled
def measure_ping(
    last_ping: Floats,
    i: int,
    s: int,
    pose: tuple[float, float, float],
    sent: float,
    mounts: Floats,
    half_angles: Floats,
    segments: Floats,
    surface: Floats,
    owner: Ints,
    max_range: float,
) -> None:
    """Write the conditions of a ping of sonar s of world i with the car at a pose; see `Hits` for the columns."""
    c, sn = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + c * mounts[s, 0] - sn * mounts[s, 1], pose[1] + sn * mounts[s, 0] + c * mounts[s, 1]
    distance, bearing, incidence, face, at_x, at_y = cast_cone(
        x, y, pose[2] + mounts[s, 2], half_angles[s], segments, max_range
    )
    last_ping[i, s, DISTANCE], last_ping[i, s, BEARING], last_ping[i, s, SENT] = distance, bearing, sent
    last_ping[i, s, X], last_ping[i, s, Y] = at_x, at_y
    last_ping[i, s, INCIDENCE], last_ping[i, s, REFLECTANCE], last_ping[i, s, OBSTACLE] = 0.0, 0.0, NO_HIT
    if face != NO_HIT:
        last_ping[i, s, INCIDENCE] = max(incidence - surface[i, face, 1], 0.0)
        last_ping[i, s, REFLECTANCE], last_ping[i, s, OBSTACLE] = surface[i, face, 0], owner[i, face]


@compiled
def receive(last_ping: Floats, in_flight: Bits, shown: Floats, i: int, s: int, now: float, latency: float) -> None:
    """Show the reading of a sonar's ping if it has arrived; readings at the start of an episode arrive at once."""
    if in_flight[i, s] and (now == 0.0 or now + SAME_TIME_S >= last_ping[i, s, SENT] + latency):
        in_flight[i, s] = False
        for k in range(N_COLUMNS):
            shown[i, s, k] = last_ping[i, s, k]


@compiled
def update_ego(
    ego: Floats32, car: Floats, odometry: Floats, i: int, scale: Floats, wheelbase: float, step: int
) -> None:
    """Write the observation of the car; speed and steering angle have the same errors as the odometry."""
    x, y, turn, pull = odometry[i, 0], odometry[i, 1], odometry[i, 2], odometry[i, PULL]
    speed, steering = car[i, 3] * (1.0 + odometry[i, SCALE]), car[i, 4]
    if pull != 0.0:  # a steering offset: driving straight appears as a bend
        steering = math.atan(math.tan(steering) + pull * wheelbase)
    scaled = (speed / scale[0], steering / scale[1])
    values = (*scaled, math.cos(turn), math.sin(turn), x / scale[2], y / scale[3], step / scale[4])
    for k in range(7):
        ego[i, k] = min(max(values[k], -1.0), 1.0)


@compiled
def update_reward(terms: Floats, car: Floats, task: Floats, ended: Bits, i: int, arc: Floats, weights: Floats) -> None:
    """Write the terms of the reward and the cost to go."""
    cost = cost_to_go(car[i, :3], task[i], arc, weights[4], weights[5])
    terms[i, 0], terms[i, 1] = weights[0] * (task[i, COST] - cost), weights[1]
    terms[i, 2] = weights[2] if ended[i, PARKED] else 0.0
    terms[i, 3] = weights[3] if ended[i, COLLISION] or ended[i, LEFT_STREET] else 0.0
    task[i, COST] = cost


@compiled
def begin(rows: Ints, w: WorldArrays, r: StepConstants) -> None:
    """Begin episodes in worlds whose car and street are set: all sonars ping, and the reward is zero."""
    last_ping, car, surface, owner, mounts, half_angles = (
        w.last_ping,
        w.car,
        w.surface,
        w.owner,
        r.mounts,
        r.half_angles,
    )
    for i in rows:
        w.steps[i] = 0
        pose, segments = (car[i, 0], car[i, 1], car[i, 2]), w.segments[i, : w.counts[i]]
        for s in range(half_angles.shape[0]):
            measure_ping(last_ping, i, s, pose, 0.0, mounts, half_angles, segments, surface, owner, r.max_range)
        w.fired[i], w.in_flight[i], w.ended[i] = True, False, False
        update_reward(w.terms, car, w.task, w.ended, i, r.arc, r.weights)
        w.terms[i] = 0.0
        update_ego(w.ego, car, w.odometry, i, r.scale, r.dynamics[0], 0)


@compiled
def advance(rows: Ints, actions: Floats, w: WorldArrays, r: StepConstants) -> None:
    """Drive the cars of some worlds for one step; each sonar pings from the pose of the car at its firing time.

    Args:
        rows: numbers of the worlds, (k,).
        actions: steering angle and speed relative to their maxima, (k, 2).
        w: state of all worlds.
        r: constants.
    """
    steps, car, task, counts, faces, surface, owner = w.steps, w.car, w.task, w.counts, w.segments, w.surface, w.owner
    last_ping, fired, in_flight, shown = w.last_ping, w.fired, w.in_flight, w.shown
    terms, ended, ego, odometry = w.terms, w.ended, w.ego, w.odometry
    dynamics, body, mounts, half_angles, timing = r.dynamics, r.body, r.mounts, r.half_angles, r.timing
    arc, weights, scale, limits, dt, max_range = r.arc, r.weights, r.scale, r.limits, r.dt, r.max_range
    h, start, before, delay = dt / PARTS, np.empty(3), np.empty(3), np.empty(half_angles.shape[0])
    for k in range(rows.shape[0]):
        i = rows[k]
        begin_s, hit, segments, state = steps[i] * dt, NO_HIT, faces[i, : counts[i]], car[i]
        steps[i] += 1
        start[0], start[1], start[2] = state[0], state[1], state[2]
        for s in range(half_angles.shape[0]):
            delay[s] = firing_delay(begin_s, dt, timing[s, 0], timing[s, 1])
            fired[i, s] = delay[s] > 0.0
            receive(last_ping, in_flight, shown, i, s, begin_s + dt, timing[s, 2])  # before the last ping is replaced
        for part in range(PARTS):
            before[0], before[1], before[2] = state[0], state[1], state[2]
            steering, speed = actions[k, 0] * dynamics[5], actions[k, 1] * dynamics[6]
            hit, curvature = drive_part(state, steering, speed, dynamics, body, segments, h)
            last = part == PARTS - 1 or hit != NO_HIT
            for s in range(half_angles.shape[0]):
                since = delay[s] - part * h
                if delay[s] > 0.0 and since > 0.0 and (last or since <= h):
                    at_end = since >= h - SAME_TIME_S  # at the end of the part, or later if the car was stopped
                    pose = (state[0], state[1], state[2]) if at_end else roll(before, state[3] * since, curvature)
                    measure_ping(
                        last_ping,
                        i,
                        s,
                        pose,
                        begin_s + delay[s],
                        mounts,
                        half_angles,
                        segments,
                        surface,
                        owner,
                        max_range,
                    )
            if last:
                break
        if hit != NO_HIT:
            state[3] = 0.0
        ended[i, COLLISION], ended[i, LEFT_STREET] = hit != NO_HIT, state[0] < limits[3]
        ended[i, PARKED] = hit == NO_HIT and is_parked(state, body, task[i], limits)
        update_odometry(odometry[i], start, state[:3])
        update_reward(terms, car, task, ended, i, arc, weights)
        update_ego(ego, car, odometry, i, scale, dynamics[0], steps[i])


@compiled
def bin_of(range_: float, edges: Floats) -> int:
    """Return the bin of a range in m; the bins have equal widths, and larger ranges are in the last bin."""
    last = edges.shape[0] - 2
    place = min(int((range_ - edges[0]) / (edges[1] - edges[0])), last)
    if range_ < edges[place]:  # the division may be wrong by rounding
        return place - 1
    return place + 1 if place < last and range_ >= edges[place + 1] else place


@compiled
def cause_of(fault: float, status: float, obstacle: float, reading: float, true: float) -> int:
    """Return the cause of a reading; a right reading is within 10 % of the true distance, as for credence (Esmi 2016).

    Args:
        fault: number of the model's fault that affects the reading, 0 for none.
        status: status of the reading, an `EchoStatus`.
        obstacle: number of the obstacle in the cone, -1 for none.
        reading: reading, m.
        true: true distance, m.
    """
    if fault > 0.0:
        return FIRST_FAULT + int(fault) - 1
    if status == _NO_ANSWER:
        return NO_ANSWER
    if status != _ECHO:
        return MISSED if obstacle >= 0.0 else EMPTY
    if obstacle < 0.0:
        return GHOST
    if abs(reading - true) <= 0.1 * true:
        return TARGET
    return EARLY if reading < true else LATE


@compiled
def update_observation(rows: Ints, w: WorldArrays, r: StepConstants) -> None:
    """Write the observation of the sonars of some worlds from the readings that have arrived.

    A reading arrives one latency after its ping and is shown until the next one. A sonar has one ping in flight.
    """
    last_ping, shown, fired, in_flight, steps = w.last_ping, w.shown, w.fired, w.in_flight, w.steps
    ranges, credence, echo, age, cause = w.ranges, w.credence, w.echo, w.age, w.cause
    timing, edges, tables, dt, max_range = r.timing, r.edges, r.tables, r.dt, r.max_range
    for i in rows:
        now = steps[i] * dt
        for s in range(timing.shape[0]):
            in_flight[i, s] |= fired[i, s]
            receive(last_ping, in_flight, shown, i, s, now, timing[s, 2])
            reading, status = shown[i, s, RANGE], shown[i, s, STATUS]
            ranges[i, s], credence[i, s], echo[i, s] = 1.0, 0.0, -1.0 if status == _NO_ANSWER else 0.0
            if status == _ECHO:
                ranges[i, s], echo[i, s] = min(reading / max_range, 1.0), 1.0
                credence[i, s] = tables[s, bin_of(reading, edges)]
            age[i, s] = min(max(now - shown[i, s, SENT], 0.0), 1.0)
            fault, obstacle, true = shown[i, s, FAULT], shown[i, s, OBSTACLE], shown[i, s, DISTANCE]
            cause[i, s] = cause_of(fault, status, obstacle, reading, true)
