"""One step of many cars, each in a street of its own, compiled by numba: what all forms of the environment run.

World number i is row i of every array; nothing passes from row to row, so rows can be stepped in any order, by any
number of threads, and alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonar_gym.compiled import compiled
from sonar_gym.sensing.kernels import NOTHING, Floats, Ints, cast_cone, drive_part, out_of_frame, roll
from sonar_gym.sensing.odometry import PULL, SCALE, count

Bits = NDArray[np.bool_]
Singles = NDArray[np.float32]
DISTANCE, BEARING, INCIDENCE, REFLECTANCE, THING, X, Y, SENT, RANGE, STATUS, GIVEN_CONDITION, FAULT = range(12)
COLUMNS = 12
GAP, GAP_END, LINE, GOAL_X, GOAL_Y, TURN, READY_X, COST = range(8)
TASK = 8
PARKED, COLLISION, LEFT_STREET = range(3)
PARTS = 5  # of a step; contact is looked for at the end of each
NOW = 1e-9  # s; two moments as near as this are one
# Why a reading is what it is, by number; a model's own faults are counted on from here
EMPTY, TARGET, EARLY, LATE, GHOST, MISSED, NO_ANSWER, FAULTS = range(8)
CAUSES = ("empty", "target", "early", "late", "ghost", "missed", "no answer")
_ECHO, _NO_ANSWER = 1, 2  # of acquisition.EchoStatus


class Worlds(NamedTuple):
    """What differs from world to world, and is written by a step.

    Attributes:
        steps: taken since the episode began, (n,).
        car: x, y, heading, speed, steering angle, (n, 5).
        kept: by the odometer, as `odometry.count` wants it, (n, 7).
        task: where the gap begins and ends, m; y of the strip's line, m; x and y of the reference path's end, m; the
            turn of its two arcs, rad; x at which they begin, m; the cost to go, m; in columns `GAP` to `COST`,
            (n, TASK).
        counts: of segments, (n,).
        segments: m, (n, m, 4).
        surface: reflectance and texture of each, 1 and rad, (n, m, 2).
        owner: number of the thing that each belongs to, (n, m).
        flying: the last ping of each sonar: the condition that it faced, when it was sent, and what was heard of it,
            in columns `DISTANCE` to `FAULT`, (n, s, COLUMNS).
        fired: whether that ping is new, (n, s).
        in_flight: whether its reading is still to come in, (n, s).
        shown: the pings whose readings came in last, (n, s, COLUMNS).
        terms: of the reward: progress, time, parked, crashed, (n, 4).
        ended: parked, collision, left the street, (n, 3).
        ranges, credence, echo, age: what is observed of the sonars, (n, s).
        ego: what is observed of the car, (n, 7).
        cause: of each reading, (n, s).
    """

    steps: Ints
    car: Floats
    kept: Floats
    task: Floats
    counts: Ints
    segments: Floats
    surface: Floats
    owner: Ints
    flying: Floats
    fired: Bits
    in_flight: Bits
    shown: Floats
    terms: Floats
    ended: Bits
    ranges: Singles
    credence: Singles
    echo: Singles
    age: Singles
    ego: Singles
    cause: Ints


class Rules(NamedTuple):
    """What is alike in all worlds.

    Attributes:
        measures: of the car, as `CarSettings.dynamics`.
        body: of the car, (4,).
        mounts: poses of the sonars in the car's frame, (s, 3).
        half: half opening angles, rad, (s,).
        timing: period, phase, latency of each sonar, s, (s, 3).
        arc: of the reference path, as `cost_to_go` wants it.
        weights: of the reward, in the order of `RewardWeights`.
        share: what `ego` is told as shares of: speed, steering, way along, way across, steps, (5,).
        limits: of `is_parked`: speed, m/s, angle, rad, overhang, m; x of the street's open end, m.
        edges, tables: credence given a reading, one table a sonar, (b + 1,), (s, b).
        dt: duration of a step, s.
        far: greatest range, m.
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
    """Return how long after `begin` a sonar fires last within dt s, (0, dt]; -1 where it does not.

    Args:
        begin: s since the episode began.
        dt: s.
        period: from ping to ping, s; 0 for one ping at the end of every dt.
        phase: time of the first ping, s.
    """
    if period <= 0.0:
        return dt
    last = phase + math.floor((begin + dt - phase + NOW) / period) * period
    return min(last - begin, dt) if last > begin + NOW and last >= phase - NOW else -1.0


@compiled
def cost_to_go(pose: Floats, task: Floats, arc: Floats, per_metre: float, per_radian: float) -> float:
    """Return the least, over the poses of the reference path, of what is left from there plus the price of being off.

    The path follows the lane, then two equal arcs backwards. Along the lane the least is known: the way back to the
    path and the way along it are weighed as light is refracted. On the arcs, poses 1 cm apart are compared.

    Args:
        pose: (3,).
        task: of this world.
        arc: rows of angle, way along x, way along y, way along the arc: rad, m, m, m, from 0 on, (k, 4).
        per_metre: price of a metre off the path, m.
        per_radian: price of a radian off its heading, m.
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
    """Return whether a car stands in its gap: slow, straight, and with no corner out of it."""
    if abs(state[3]) > limits[0] or abs(state[2]) > limits[1]:
        return False
    for x, y in ((body[0], body[1]), (body[0], body[3]), (body[2], body[1]), (body[2], body[3])):
        at_x, at_y = out_of_frame(x, y, state)
        if not task[GAP] <= at_x <= task[GAP_END] or at_y > task[LINE] + limits[2]:
            return False
    return True


# Below, bundles are taken apart once a call: to reach into one counts references, which costs more than the work.


@compiled
def ping(
    flying: Floats,
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
    """Note what sonar s of world i meets with the car at a pose; see `Hits` for the meaning of each number."""
    c, sn = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + c * mounts[s, 0] - sn * mounts[s, 1], pose[1] + sn * mounts[s, 0] + c * mounts[s, 1]
    away, bearing, met, face, at_x, at_y = cast_cone(x, y, pose[2] + mounts[s, 2], half[s], segments, far)
    flying[i, s, DISTANCE], flying[i, s, BEARING], flying[i, s, SENT] = away, bearing, sent
    flying[i, s, X], flying[i, s, Y] = at_x, at_y
    flying[i, s, INCIDENCE], flying[i, s, REFLECTANCE], flying[i, s, THING] = 0.0, 0.0, NOTHING
    if face != NOTHING:
        flying[i, s, INCIDENCE] = max(met - surface[i, face, 1], 0.0)
        flying[i, s, REFLECTANCE], flying[i, s, THING] = surface[i, face, 0], owner[i, face]


@compiled
def land(flying: Floats, in_flight: Bits, shown: Floats, i: int, s: int, now: float, latency: float) -> None:
    """Show the reading of a sonar's ping if it has come in by now; what is known when an episode begins is known."""
    if in_flight[i, s] and (now == 0.0 or now + NOW >= flying[i, s, SENT] + latency):
        in_flight[i, s] = False
        for k in range(COLUMNS):
            shown[i, s, k] = flying[i, s, k]


@compiled
def note_ego(ego: Singles, car: Floats, kept: Floats, i: int, share: Floats, wheelbase: float, step: int) -> None:
    """Write what wheels, steering and clock tell: with the same errors as the way that they are summed up to."""
    x, y, turn, pull = kept[i, 0], kept[i, 1], kept[i, 2], kept[i, PULL]
    speed, steering = car[i, 3] * (1.0 + kept[i, SCALE]), car[i, 4]
    if pull != 0.0:  # the steering's zero is off by so much that a straight way is taken for a bend
        steering = math.atan(math.tan(steering) + pull * wheelbase)
    shares = (speed / share[0], steering / share[1])
    told = (*shares, math.cos(turn), math.sin(turn), x / share[2], y / share[3], step / share[4])
    for k in range(7):
        ego[i, k] = min(max(told[k], -1.0), 1.0)


@compiled
def pay(terms: Floats, car: Floats, task: Floats, ended: Bits, i: int, arc: Floats, weights: Floats) -> None:
    """Write the terms of the reward and the cost to go from here."""
    cost = cost_to_go(car[i, :3], task[i], arc, weights[4], weights[5])
    terms[i, 0], terms[i, 1] = weights[0] * (task[i, COST] - cost), weights[1]
    terms[i, 2] = weights[2] if ended[i, PARKED] else 0.0
    terms[i, 3] = weights[3] if ended[i, COLLISION] or ended[i, LEFT_STREET] else 0.0
    task[i, COST] = cost


@compiled
def begin(rows: Ints, w: Worlds, r: Rules) -> None:
    """Begin episodes in some worlds, whose cars stand and streets lie: all sonars look, everything else is nothing."""
    flying, car, surface, owner, mounts, half = w.flying, w.car, w.surface, w.owner, r.mounts, r.half
    for i in rows:
        w.steps[i] = 0
        pose, segments = (car[i, 0], car[i, 1], car[i, 2]), w.segments[i, : w.counts[i]]
        for s in range(half.shape[0]):
            ping(flying, i, s, pose, 0.0, mounts, half, segments, surface, owner, r.far)
        w.fired[i], w.in_flight[i], w.ended[i] = True, False, False
        pay(w.terms, car, w.task, w.ended, i, r.arc, r.weights)
        w.terms[i] = 0.0
        note_ego(w.ego, car, w.kept, i, r.share, r.measures[0], 0)


@compiled
def advance(rows: Ints, wanted: Floats, w: Worlds, r: Rules) -> None:
    """Drive the cars of some worlds for a step, each sonar looking from where the car is when it fires.

    Args:
        rows: which worlds.
        wanted: steering and speed as shares of the greatest, one row for each of `rows`, (k, 2).
        w: the worlds.
        r: what is alike in all.
    """
    steps, car, task, counts, faces, surface, owner = w.steps, w.car, w.task, w.counts, w.segments, w.surface, w.owner
    flying, fired, in_flight, shown = w.flying, w.fired, w.in_flight, w.shown
    terms, ended, ego, kept = w.terms, w.ended, w.ego, w.kept
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
            land(flying, in_flight, shown, i, s, begun + dt, timing[s, 2])  # what is in by then, before it is replaced
        for part in range(PARTS):
            before[0], before[1], before[2] = state[0], state[1], state[2]
            steering, speed = wanted[k, 0] * measures[5], wanted[k, 1] * measures[6]
            hit, curvature = drive_part(state, steering, speed, measures, body, segments, h)
            last = part == PARTS - 1 or hit != NOTHING
            for s in range(half.shape[0]):
                since = due[s] - part * h
                if due[s] > 0.0 and since > 0.0 and (last or since <= h):
                    there = since >= h - NOW  # the end of the part, or later, where the car was stopped
                    pose = (state[0], state[1], state[2]) if there else roll(before, state[3] * since, curvature)
                    ping(flying, i, s, pose, begun + due[s], mounts, half, segments, surface, owner, far)
            if last:
                break
        if hit != NOTHING:
            state[3] = 0.0
        ended[i, COLLISION], ended[i, LEFT_STREET] = hit != NOTHING, state[0] < limits[3]
        ended[i, PARKED] = hit == NOTHING and is_parked(state, body, task[i], limits)
        count(kept[i], start, state[:3])
        pay(terms, car, task, ended, i, arc, weights)
        note_ego(ego, car, kept, i, share, measures[0], steps[i])


@compiled
def bin_of(range_: float, edges: Floats) -> int:
    """Return the bin that a range in m falls into; the bins are equally wide, and what lies beyond is in the last."""
    last = edges.shape[0] - 2
    place = min(int((range_ - edges[0]) / (edges[1] - edges[0])), last)
    if range_ < edges[place]:  # the division may be off by a rounding
        return place - 1
    return place + 1 if place < last and range_ >= edges[place + 1] else place


@compiled
def cause_of(fault: float, status: float, thing: float, said: float, true: float) -> int:
    """Return why a reading is what it is; right is within 10 % of the truth, as for credence (Esmi 2016).

    Args:
        fault: number of the model's fault that struck, 0 for none.
        status: of the reading, an `EchoStatus`.
        thing: that the ping met, -1 for none.
        said: reading, m.
        true: distance, m.
    """
    if fault > 0.0:
        return FAULTS + int(fault) - 1
    if status == _NO_ANSWER:
        return NO_ANSWER
    if status != _ECHO:
        return MISSED if thing >= 0.0 else EMPTY
    if thing < 0.0:
        return GHOST
    if abs(said - true) <= 0.1 * true:
        return TARGET
    return EARLY if said < true else LATE


@compiled
def tell(rows: Ints, w: Worlds, r: Rules) -> None:
    """Show the readings of some worlds that have come in by now.

    A sonar's reading comes in a latency after its ping, and stays until the next. A sonar has one ping in flight.
    """
    flying, shown, fired, in_flight, steps = w.flying, w.shown, w.fired, w.in_flight, w.steps
    ranges, credence, echo, age, cause = w.ranges, w.credence, w.echo, w.age, w.cause
    timing, edges, tables, dt, far = r.timing, r.edges, r.tables, r.dt, r.far
    for i in rows:
        now = steps[i] * dt
        for s in range(timing.shape[0]):
            in_flight[i, s] |= fired[i, s]
            land(flying, in_flight, shown, i, s, now, timing[s, 2])
            said, status = shown[i, s, RANGE], shown[i, s, STATUS]
            ranges[i, s], credence[i, s], echo[i, s] = 1.0, 0.0, -1.0 if status == _NO_ANSWER else 0.0
            if status == _ECHO:
                ranges[i, s], echo[i, s] = min(said / far, 1.0), 1.0
                credence[i, s] = tables[s, bin_of(said, edges)]
            age[i, s] = min(max(now - shown[i, s, SENT], 0.0), 1.0)
            fault, thing, true = shown[i, s, FAULT], shown[i, s, THING], shown[i, s, DISTANCE]
            cause[i, s] = cause_of(fault, status, thing, said, true)
