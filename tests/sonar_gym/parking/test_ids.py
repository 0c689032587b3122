"""The registered environments, and the manoeuvre: streets that need several moves."""

import heapq

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import sonar_gym
from sonar_gym.parking.step_kernel import is_parked
from sonar_gym.sensing.kernels import touches
from sonar_gym.street.street import LEVELS, draw_street
from sonar_gym.street.vehicle import CarSettings

CAR = CarSettings()
LIMITS = np.array([0.03, np.radians(10.0), 0.02, -1.5])  # of a parked car
CELL = np.array([0.01, 0.01, np.radians(2.0)])  # resolution of the search, m, m, rad
ARC = 0.012  # m; length of a part of a move
SWITCH = 0.1  # m; cost of a change of direction


@pytest.mark.parametrize("env_id", [*sonar_gym.ENVIRONMENTS, sonar_gym.GOAL_ENV_ID])
def test_every_id_is_registered_with_a_threshold_and_a_time_limit(env_id):
    spec = gymnasium.spec(env_id)
    assert spec.max_episode_steps == (100 if env_id == sonar_gym.GOAL_ENV_ID else 400)
    assert spec.reward_threshold is not None
    env = gymnasium.make(env_id)
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize(("env_id", "level"), [(name, level) for name, (level, _) in sonar_gym.ENVIRONMENTS.items()])
def test_streets_of_an_id_are_those_of_its_difficulty_single_and_vector(env_id, level):
    single, many = gymnasium.make(env_id), gymnasium.make_vec(env_id, num_envs=1)
    single.reset(seed=5)
    many.reset(seed=5)
    expected = draw_street(LEVELS[level], np.random.default_rng(5))
    for street in (single.unwrapped.street, many.fleet.world(0).street):
        assert np.array_equal(street.strip, expected.strip)


def test_turned_boxes_keep_their_extent_and_leave_the_gap_free():
    for seed in range(50):
        street = draw_street(LEVELS["manoeuvre"], np.random.default_rng(seed))
        for box, (begin, length, recess, *_) in zip(street.boxes, street.strip, strict=True):
            low, high = box.corners.min(axis=0), box.corners.max(axis=0)
            assert (low[0], high[0]) == pytest.approx((begin, begin + length))
            assert (low[1], high[1]) == pytest.approx((street.kerb, street.line - recess))
        assert street.gap[1] - street.gap[0] == pytest.approx(1.15 * CAR.length)


def parked_poses(street):
    """Yield poses in the gap that count as parked and touch nothing."""
    task, segments = np.array([*street.gap, street.line, 0.0, 0.0, 0.0, 0.0, 0.0]), street.scene.segments
    for x in np.arange(street.gap[0] + CAR.rear_overhang + 0.005, street.gap[1] - 0.36, 0.01):
        for y in np.arange(street.line - 0.22, street.line - 0.07, 0.01):
            for turn in np.radians([-8.0, -4.0, 0.0, 4.0, 8.0]):
                pose = np.array([x, y, turn])
                state = np.array([*pose, 0.0, 0.0])
                if touches(pose, CAR.body, segments) < 0 and is_parked(state, CAR.body, task, LIMITS):
                    yield tuple(pose)


def rolled(pose, way, curvature, segments):
    """Return the pose after two parts of a move, or None if the car touches something."""
    for _ in range(2):
        middle = pose[2] + 0.5 * curvature * way
        pose = (pose[0] + way * np.cos(middle), pose[1] + way * np.sin(middle), pose[2] + curvature * way)
        if touches(np.array(pose), CAR.body, segments) >= 0:
            return None
    return pose


def moves_out(street, most=400_000):
    """Return the number of moves from a parked pose to the lane by a search (hybrid A*), None if there is no way."""
    segments, queue, seen, count = street.scene.segments, [], set(), 0
    for pose in parked_poses(street):
        heapq.heappush(queue, (0.0, count, 0, 1, pose))
        count += 1
    while queue and len(seen) < most:
        cost, _, direction, moves, pose = heapq.heappop(queue)
        cell = (*np.rint(np.array(pose) / CELL).astype(int).tolist(), direction)
        if cell in seen:
            continue
        seen.add(cell)
        if abs(pose[1]) < 0.05 and abs(pose[2]) < 0.17:
            return moves
        for way in (ARC, -ARC):
            for curvature in np.array([-1.0, 0.0, 1.0]) / CAR.turning_radius:
                reached = rolled(pose, way, curvature, segments)
                if reached is not None:
                    switched = way * direction < 0.0
                    heapq.heappush(
                        queue,
                        (cost + 2 * ARC + SWITCH * switched, count, 1 if way > 0 else -1, moves + switched, reached),
                    )
                    count += 1
    return None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("level", "seed"), [*(("manoeuvre", seed) for seed in range(10)), ("normal", 0), ("hard", 0), ("hard", 1)]
)
def test_only_a_manoeuvre_needs_several_moves(level, seed):
    """Driven backwards in time, the way out is the way in."""
    moves = moves_out(draw_street(LEVELS[level], np.random.default_rng(seed)))
    assert moves is not None
    assert (moves >= 2) == (level == "manoeuvre")
