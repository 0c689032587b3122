"""One step of many cars, each on its own street, compiled by numba; all forms of the environment use it.

World i is row i of every array. Rows are independent, so they can be stepped in any order and in several threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from acquisition.arrays import Bits, Floats, Ints, Singles
from acquisition.limits import Limit, check_settings
from sonar_gym.compiled import compiled
from sonar_gym.sensing.crosstalk import Surroundings, add_crosstalk
from sonar_gym.sensing.kernels import NO_HIT, drive_part, out_of_frame, roll, shift
from sonar_gym.sensing.odometry import PULL, SCALE, update_odometry
from sonar_gym.sensing.paths import cast_paths, meet_moving
from sonar_gym.sensing.records import SAME_TIME_S, PingArrays, firing_delay
from sonar_gym.street.cost_to_go import cost_to_go

GAP, GAP_END, LINE, GOAL_X, GOAL_Y, TURN, READY_X, TABLE, COST = range(9)
N_TASK = 9
PARKED, COLLISION, LEFT_STREET = range(3)
REWARD_TERMS = ("shaping", "time", "parked", "crashed")
# Weights of the reward, in the order of the fields of `RewardWeights`
POTENTIAL, DISCOUNT, TIME, PARKED_ONCE, CRASHED_ONCE, CRASH_DISTANCE = range(6)
PARTS = 5  # parts of a step; contact is tested at the end of each


Weight = Annotated[float, Limit(-1e6, 1e6)]


@dataclass(frozen=True)
class RewardWeights:
    """Weights of the reward.

    The task's own reward is `time`, `parked` and `crashed`. To it a potential-based shaping is added (Ng, Harada and
    Russell 1999): `discount` * Phi(next pose) - Phi(pose), where Phi is minus `potential` times the cost to go
    (`cost_to_go`), and zero where the episode ends. Its discounted sum depends on the start alone, so the best policy
    is that of the task's own reward.

    Attributes:
        potential: potential per metre of cost to go; 0 for the task's own reward alone.
        discount: discount of the shaping, 0..1; 1 for the undiscounted sum of rewards.
        time: per step.
        parked: once, for standing in the gap.
        crashed: once, for touching an obstacle or leaving the street.
        crash_distance: once, per metre of cost to go from the place where the car crashed.
    """

    potential: Weight = 5.0
    discount: Annotated[float, Limit(0.0, 1.0)] = 1.0
    time: Weight = -0.05
    parked: Weight = 10.0
    crashed: Weight = -3.0
    crash_distance: Weight = -5.0

    def __post_init__(self) -> None:
        """Raise SettingError for a weight that is not finite, or a discount beyond 0..1."""
        check_settings(self)


class WorldArrays(NamedTuple):
    """State of n worlds, modified by a step; the pings of the sonars are `records.PingArrays`.

    Attributes:
        steps: number of steps in the episode, (n,).
        car: x, y, heading, speed, steering angle: m, m, rad, m/s, rad, (n, 5).
        odometry: state of the odometry, see `odometry.update_odometry`, (n, 7).
        task: begin and end of the gap, m; y of the strip's line, m; x and y of the end of the reference path, m; angle
            of its two arcs, rad; x at which they begin, m; number of the table of cost to go; cost to go, m; in columns
            `GAP` to `COST`, (n, N_TASK).
        mounts: poses of the sonars in the frame of the car, (n, s, 3).
        counts: number of segments, (n,).
        segments: segments, m, (n, m, 4).
        surface: reflectance and slope of the facets of each segment, 1 and rad, (n, m, 2).
        owner: number of the obstacle of each segment, (n, m).
        velocity: velocity of each segment, m/s, (n, m, 2).
        moves: whether any segment of a street moves, (n,).
        floor: reflectance and slope of the facets of the floor, 1 and rad, (n, 2).
        terms: terms of the reward: shaping, time, parked, crashed, (n, 4).
        ended: parked, collision, left the street, (n, 3).
        ego: observation of the car, (n, 7).
    """

    steps: Ints
    car: Floats
    odometry: Floats
    task: Floats
    mounts: Floats
    counts: Ints
    segments: Floats
    surface: Floats
    owner: Ints
    velocity: Floats
    moves: Bits
    floor: Floats
    terms: Floats
    ended: Bits
    ego: Singles


class Faces(NamedTuple):
    """Faces of one street.

    Attributes:
        segments: segments, m, (m, 4); moved where they move.
        surface: reflectance and slope of the facets of each, 1 and rad, (m, 2).
        owner: number of the obstacle of each, (m,).
        velocity: velocity of each, m/s, (m, 2).
        moves: whether any of them moves.
        floor: reflectance and slope of the facets of the floor, 1 and rad, (2,).
    """

    segments: Floats
    surface: Floats
    owner: Ints
    velocity: Floats
    moves: bool
    floor: Floats


class StepConstants(NamedTuple):
    """Quantities that are equal in all worlds.

    Attributes:
        dynamics: `CarSettings.dynamics`, (7,).
        body: rectangle of the car, (4,).
        half_angles: half opening angles, rad, (s,).
        heights: heights of the sonars above the floor, m, 0 for those that do not hear it, (s,).
        timing: period, phase and latency of each sonar, s, (s, 3).
        grids: headers of the tables of cost to go, see `cost_to_go`, (k, N_GRID).
        costs: their values, m.
        weights: weights of the reward, in the order of `RewardWeights`.
        scale: scales of `ego`: speed, steering angle, distance along, distance across, steps, (5,).
        limits: limits of `is_parked`: speed, m/s, angle, rad, overhang, m; x of the open end of the street, m.
        detection: see `detection.detection_table`.
        listening: see `detection.listening_table`.
        crosstalk: whether sonars hear each other's bursts.
        dt: duration of a step, s.
        max_range: maximum range, m.
    """

    dynamics: Floats
    body: Floats
    half_angles: Floats
    heights: Floats
    timing: Floats
    grids: Floats
    costs: Singles
    weights: Floats
    scale: Floats
    limits: Floats
    detection: Floats
    listening: Floats
    crosstalk: bool
    dt: float
    max_range: float


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


@compiled
def measure_ping(
    out: Floats, s: int, pose: tuple[float, float, float], mounts: Floats, faces: Faces, r: StepConstants,
    sensors: Floats,
) -> int:  # fmt: skip
    """Write the paths of a ping of sonar s with the car at a pose, and its pose; return the number of paths."""
    c, sn = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + c * mounts[s, 0] - sn * mounts[s, 1], pose[1] + sn * mounts[s, 0] + c * mounts[s, 1]
    heading = pose[2] + mounts[s, 2]
    sensors[s, 0], sensors[s, 1], sensors[s, 2] = x, y, heading
    floor = (r.heights[s], faces.floor[0], faces.floor[1])
    count = cast_paths(
        x, y, heading, r.half_angles[s], faces.segments, faces.surface, faces.owner, r.max_range, r.detection, out,
        floor,
    )  # fmt: skip
    if faces.moves:
        for j in range(count):
            meet_moving(out[j], x, y, faces.velocity)
    return count


@compiled
def hear_others(faces: Faces, k: int, i: int, sensors: Floats, r: StepConstants, p: PingArrays) -> None:
    """Add the paths of other bursts to the pings of world i, the k-th of an update."""
    if r.crosstalk:
        around = Surroundings(faces.segments, faces.surface, faces.owner, r.max_range, r.detection, r.listening)
        add_crosstalk(sensors, p.fired[k], p.sent[k], p.before[i], around, p.paths[k], p.n_paths[k])


@compiled
def update_ego(ego: Singles, car: Floats, odometry: Floats, i: int, scale: Floats, wheelbase: float, step: int) -> None:
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
def update_reward(w: WorldArrays, i: int, r: StepConstants) -> None:
    """Write the terms of the reward and the cost to go."""
    weights, terms, task, ended, car = r.weights, w.terms[i], w.task[i], w.ended[i], w.car[i]
    cost = cost_to_go(car[0] - task[GAP], car[1], car[2], r.grids[int(task[TABLE])], r.costs)
    crashed = ended[COLLISION] or ended[LEFT_STREET]
    next_cost = 0.0 if crashed or ended[PARKED] else cost  # the potential is zero where an episode ends
    terms[0] = weights[POTENTIAL] * (task[COST] - weights[DISCOUNT] * next_cost)
    terms[1] = weights[TIME]
    terms[2] = weights[PARKED_ONCE] if ended[PARKED] else 0.0
    terms[3] = weights[CRASHED_ONCE] + weights[CRASH_DISTANCE] * cost if crashed else 0.0
    task[COST] = cost


@compiled
def faces_of(i: int, w: WorldArrays) -> Faces:
    """Return the faces of a street."""
    n = w.counts[i]
    return Faces(w.segments[i, :n], w.surface[i, :n], w.owner[i, :n], w.velocity[i, :n], w.moves[i], w.floor[i])


@compiled
def measure(rows: Ints, w: WorldArrays, r: StepConstants, p: PingArrays) -> None:
    """Write the paths of pings of all sonars where the cars of some worlds stand; their times are given in `p.sent`."""
    sensors = np.empty((r.half_angles.shape[0], 3))
    for k in range(rows.shape[0]):
        i = rows[k]
        pose, faces = (w.car[i, 0], w.car[i, 1], w.car[i, 2]), faces_of(i, w)
        for s in range(r.half_angles.shape[0]):
            p.n_paths[k, s] = measure_ping(p.paths[k, s], s, pose, w.mounts[i], faces, r, sensors)
        hear_others(faces, k, i, sensors, r, p)


@compiled
def begin(rows: Ints, w: WorldArrays, r: StepConstants, p: PingArrays) -> None:
    """Begin episodes in worlds whose car and street are set: all sonars ping, and the reward is zero."""
    measure(rows, w, r, p)
    for i in rows:
        w.steps[i] = 0
        w.ended[i] = False
        update_reward(w, i, r)
        w.terms[i] = 0.0
        update_ego(w.ego, w.car, w.odometry, i, r.scale, r.dynamics[0], 0)


@compiled
def drive(
    state: Floats,
    command: tuple[float, float],
    delay: Floats,
    mounts: Floats,
    faces: Faces,
    r: StepConstants,
    paths: Floats,
    n_paths: Ints,
    sensors: Floats,
) -> int:
    """Drive a car for one step; each sonar pings from the pose of the car, to the faces, at its firing time.

    Args:
        state: state of the car, (5,); modified.
        command: steering angle, rad, and speed, m/s.
        delay: delay of the ping of each sonar from the begin of the step, s, (s,); not positive for none.
        mounts: poses of the sonars in the frame of the car, (s, 3).
        faces: faces of the street; those that move are moved.
        r: constants.
        paths: paths of the pings, (s, MAX_PATHS, N_PATH); written.
        n_paths: numbers of these, (s,); written.
        sensors: poses of the sonars that ping, (s, 3); written.

    Returns:
        The index of the face that was touched, or -1.
    """
    h, before, segments = r.dt / PARTS, np.empty(3), faces.segments
    for part in range(PARTS):
        before[0], before[1], before[2] = state[0], state[1], state[2]
        if faces.moves:
            shift(segments, faces.velocity, h)
        hit, curvature = drive_part(state, command[0], command[1], r.dynamics, r.body, segments, h)
        last = part == PARTS - 1 or hit != NO_HIT
        for s in range(delay.shape[0]):
            since = delay[s] - part * h
            # each delay belongs to one part, also where rounding puts it on the border of two
            if delay[s] > 0.0 and since > SAME_TIME_S and (last or since <= h + SAME_TIME_S):
                at_end = since >= h - SAME_TIME_S  # at the end of the part, or later if the car was stopped
                pose = (state[0], state[1], state[2]) if at_end else roll(before, state[3] * since, curvature)
                if faces.moves and not at_end:
                    shift(segments, faces.velocity, since - h)
                n_paths[s] = measure_ping(paths[s], s, pose, mounts, faces, r, sensors)
                if faces.moves and not at_end:
                    shift(segments, faces.velocity, h - since)
        if last:
            break
    return hit


@compiled
def advance(rows: Ints, actions: Floats, w: WorldArrays, r: StepConstants, p: PingArrays) -> None:
    """Drive the cars of some worlds for one step.

    Args:
        rows: numbers of the worlds, (k,).
        actions: steering angle and speed relative to their maxima, (k, 2).
        w: state of all worlds.
        r: constants.
        p: pings of all worlds.
    """
    count = r.timing.shape[0]
    sensors, start, delay = np.zeros((count, 3)), np.empty(3), np.empty(count)
    for k in range(rows.shape[0]):
        i = rows[k]
        begin_s, state, faces = w.steps[i] * r.dt, w.car[i], faces_of(i, w)
        w.steps[i] += 1
        start[0], start[1], start[2] = state[0], state[1], state[2]
        for s in range(count):
            delay[s] = firing_delay(begin_s, r.dt, r.timing[s, 0], r.timing[s, 1])
            p.fired[k, s], p.sent[k, s] = delay[s] > 0.0, begin_s + delay[s]
        command = actions[k, 0] * r.dynamics[5], actions[k, 1] * r.dynamics[6]
        hit = drive(state, command, delay, w.mounts[i], faces, r, p.paths[k], p.n_paths[k], sensors)
        hear_others(faces, k, i, sensors, r, p)
        finish(i, hit, start, w, r)


@compiled
def finish(i: int, hit: int, start: Floats, w: WorldArrays, r: StepConstants) -> None:
    """Write how a step ended, its odometry since a pose, its reward and the observation of the car."""
    state, ended = w.car[i], w.ended[i]
    if hit != NO_HIT:
        state[3] = 0.0
    ended[COLLISION], ended[LEFT_STREET] = hit != NO_HIT, state[0] < r.limits[3]
    ended[PARKED] = hit == NO_HIT and is_parked(state, r.body, w.task[i], r.limits)
    update_odometry(w.odometry[i], start, state[:3])
    update_reward(w, i, r)
    update_ego(w.ego, w.car, w.odometry, i, r.scale, r.dynamics[0], w.steps[i])
