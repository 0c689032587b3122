"""The memory of an agent: what it keeps, where, and what it may not know."""

import numpy as np
import pytest

from acquisition import SettingError
from sonar_gym.control.memory import FAR, STEP, Memory, MemorySettings
from sonar_gym.parking.fleet import MAX_RANGE, ODOMETRY_SPAN
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sensing.mounts import LAYOUTS

ONE = np.zeros(1, dtype=np.int64)
NAMES = [mount.name for mount in LAYOUTS["eight"]]
SIDE = NAMES.index("right rear")  # at the rear axle, 0.10 m to the right


def observation(x=0.0, y=0.0, turn=0.0, right=FAR, echo=1.0, credence=1.0, n=1):
    ranges = np.full((n, 8), 1.0, dtype=np.float32)
    heard = np.full((n, 8), -1.0, dtype=np.float32)  # the other sonars are dead
    ranges[:, SIDE], heard[:, SIDE] = right / MAX_RANGE, echo
    ego = [0.0, 0.0, np.cos(turn), np.sin(turn), x / ODOMETRY_SPAN[0], y / ODOMETRY_SPAN[1], 0.0]
    return {
        "ranges": ranges,
        "credence": np.where(heard > 0, credence, 0.0).astype(np.float32),
        "echo": heard,
        "ego": np.tile(np.float32(ego), (n, 1)),
    }


def strip(memory):
    """What is shown of the right: distance from the rear axle's line, m, and weight, by place."""
    places = len(memory.settings.places)
    begin = memory.size - 2 * places - len(memory.settings.places[:: memory.settings.coarse])
    shown = memory.show(ONE)[0]
    return shown[begin : begin + places] / 2.0, shown[begin + places : begin + 2 * places]


def passed(depths, **more):
    memory = Memory(1)
    memory.forget(ONE)
    for k, depth in enumerate(depths):
        memory.see(ONE, observation(x=STEP * k, right=depth, **more))
    return memory


def test_a_strip_shows_what_was_passed_where_it_was():
    depths = np.r_[np.full(10, 0.2), np.full(10, 0.6), np.full(10, 0.3)]
    distance, weight = strip(passed(depths))
    places = Memory(1).settings.places
    seen = weight > 0.3
    here = STEP * (len(depths) - 1)
    expected = 0.10 + depths[np.rint((places[seen] + here) / STEP).astype(int).clip(0, 29)]
    inside = np.abs(np.gradient(expected)) == 0  # at an edge neighbours are mixed
    assert inside.sum() > 20
    assert distance[seen][inside] == pytest.approx(expected[inside], abs=0.02)


def test_what_was_not_seen_weighs_nothing():
    distance, weight = strip(passed([0.2]))
    places = Memory(1).settings.places
    front = LAYOUTS["eight"][NAMES.index("right front")].x
    away = (np.abs(places) > 2 * STEP) & (np.abs(places - front) > 2 * STEP)
    assert np.all(weight[away] == 0.0)
    assert np.all(distance[away] == 0.0)


def test_memory_follows_the_car_and_not_its_frame():
    """Moving on, and being turned, shows the same things from another place."""
    memory = passed(np.full(20, 0.25))
    before, _ = strip(memory)
    memory.see(ONE, observation(x=STEP * 19, y=0.1, right=0.35))
    after, weight = strip(memory)
    far_behind = (Memory(1).settings.places < -0.3) & (weight > 0.3)
    assert far_behind.sum() >= 8
    assert after[far_behind] == pytest.approx(before[far_behind] + 0.1, abs=0.01)


def test_side_sonars_of_a_turned_car_do_not_write():
    memory = Memory(1)
    memory.forget(ONE)
    memory.see(ONE, observation(turn=0.5, right=0.2))
    assert np.all(strip(memory)[1] == 0.0)


def test_no_answer_writes_nothing_and_silence_little():
    dead, silent, sure = (passed([0.2] * 5, echo=echo) for echo in (-1.0, 0.0, 1.0))
    place = np.argmin(np.abs(Memory(1).settings.places))
    assert strip(silent)[1][place] < strip(sure)[1][place]
    assert strip(dead)[1][place] <= strip(silent)[1][place]


def test_credible_readings_outweigh_doubtful_ones():
    memory = Memory(1)
    memory.forget(ONE)
    memory.see(ONE, observation(right=0.2, credence=1.0))
    memory.see(ONE, observation(right=0.8, credence=0.0))
    place = np.argmin(np.abs(memory.settings.places))
    assert strip(memory)[0][place] == pytest.approx(0.1 + (0.2 + 0.1 * 0.8) / 1.1, abs=0.01)


def test_without_credence_nothing_shown_depends_on_it():
    settings = MemorySettings(credence=False)
    shown = []
    for credence in (0.1, 0.9):
        memory = Memory(1, settings=settings)
        memory.forget(ONE)
        for k in range(5):
            memory.see(ONE, observation(x=STEP * k, right=0.2 + 0.1 * k, credence=credence))
        shown.append(memory.show(ONE))
    assert np.array_equal(*shown)


def test_the_way_is_counted_from_where_the_car_turned_back():
    memory = Memory(1)
    memory.forget(ONE)
    for x in np.r_[np.arange(0.0, 0.5, 0.02), np.arange(0.48, 0.3, -0.02)]:
        memory.see(ONE, observation(x=x))
    assert memory.way[0] == pytest.approx(0.32 - 0.48, abs=0.011)


def test_standing_does_not_turn_the_way():
    memory = Memory(1)
    memory.forget(ONE)
    for x in (0.1, 0.2, 0.2, 0.199, 0.2, 0.201):
        memory.see(ONE, observation(x=x))
    assert memory.way[0] > 0.19


def test_forgetting_leaves_nothing_and_touches_no_other():
    memory = Memory(2)
    both = np.arange(2)
    memory.forget(both)
    fresh = memory.show(both)
    for k in range(30):
        memory.see(both, observation(x=STEP * k, right=0.3, n=2))
    before = memory.show(both)
    memory.forget(np.array([0]))
    assert np.array_equal(memory.show(both)[0], fresh[0])
    assert np.array_equal(memory.show(both)[1], before[1])


def test_many_remember_as_each_alone():
    n = 5
    envs = SonarParkingVectorEnv(n, sonar="gaussian", threads=1)
    together, apart = Memory(n), [Memory(1) for _ in range(n)]
    seen, _ = envs.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(40):
        together.see(np.arange(n), seen)
        for i, memory in enumerate(apart):
            memory.see(ONE, {name: value[i : i + 1] for name, value in seen.items()})
        seen, *_ = envs.step(rng.uniform(0.0, 1.0, (n, 2)) * [0.2, 1.0])
    assert np.array_equal(together.show(np.arange(n)), np.concatenate([memory.show(ONE) for memory in apart]))
    assert np.abs(together.show(np.arange(n))).max() <= 10.0
    envs.close()


@pytest.mark.parametrize("wrong", [{"lags": 0}, {"coarse": 0}, {"behind": -1.0}, {"ahead": 9.0}])
def test_settings_of_no_memory_are_refused(wrong):
    with pytest.raises(SettingError, match="MemorySettings"):
        MemorySettings(**wrong)
