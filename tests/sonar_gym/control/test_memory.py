"""The observation memory: position and weight of what it stores, and its independence of other cars."""

import numpy as np
import pytest

from acquisition import SettingError
from sonar_gym.control.memory import GRID_STEP, MAX_DISTANCE, MemorySettings, ObservationMemory
from sonar_gym.parking.fleet import MAX_RANGE, ODOMETRY_SPAN
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sensing.mounts import LAYOUTS

ONE = np.zeros(1, dtype=np.int64)
NAMES = [mount.name for mount in LAYOUTS["eight"]]
SIDE = NAMES.index("right rear")  # at the rear axle, 0.10 m to the right


def observation(x=0.0, y=0.0, turn=0.0, right=MAX_DISTANCE, echo=1.0, credence=1.0, n=1):
    ranges = np.full((n, 8), 1.0, dtype=np.float32)
    echoes = np.full((n, 8), -1.0, dtype=np.float32)  # the other sonars give no answer
    ranges[:, SIDE], echoes[:, SIDE] = right / MAX_RANGE, echo
    ego = [0.0, 0.0, np.cos(turn), np.sin(turn), x / ODOMETRY_SPAN[0], y / ODOMETRY_SPAN[1], 0.0]
    return {
        "ranges": ranges,
        "credence": np.where(echoes > 0, credence, 0.0).astype(np.float32),
        "echo": echoes,
        "ego": np.tile(np.float32(ego), (n, 1)),
    }


def right_profile(memory):
    """Return the right profile: distance from the axis of the car, m, and weight, by grid point."""
    places = len(memory.settings.places)
    begin = memory.size - 2 * places - len(memory.settings.places[:: memory.settings.coarse])
    shown = memory.features(ONE)[0]
    return shown[begin : begin + places] / 2.0, shown[begin + places : begin + 2 * places]


def passed(depths, **more):
    memory = ObservationMemory(1)
    memory.reset(ONE)
    for k, depth in enumerate(depths):
        memory.update(ONE, observation(x=GRID_STEP * k, right=depth, **more))
    return memory


def test_profile_has_the_passed_distances_at_their_positions():
    depths = np.r_[np.full(10, 0.2), np.full(10, 0.6), np.full(10, 0.3)]
    distance, weight = right_profile(passed(depths))
    places = ObservationMemory(1).settings.places
    seen = weight > 0.3
    here = GRID_STEP * (len(depths) - 1)
    expected = 0.10 + depths[np.rint((places[seen] + here) / GRID_STEP).astype(int).clip(0, 29)]
    inside = np.abs(np.gradient(expected)) == 0  # at an edge neighbours are mixed
    assert inside.sum() > 20
    assert distance[seen][inside] == pytest.approx(expected[inside], abs=0.02)


def test_positions_that_were_not_passed_have_no_weight():
    distance, weight = right_profile(passed([0.2]))
    places = ObservationMemory(1).settings.places
    front = LAYOUTS["eight"][NAMES.index("right front")].x
    away = (np.abs(places) > 2 * GRID_STEP) & (np.abs(places - front) > 2 * GRID_STEP)
    assert np.all(weight[away] == 0.0)
    assert np.all(distance[away] == 0.0)


def test_profile_moves_with_the_car():
    """After a lateral motion the same objects appear at another distance."""
    memory = passed(np.full(20, 0.25))
    before, _ = right_profile(memory)
    memory.update(ONE, observation(x=GRID_STEP * 19, y=0.1, right=0.35))
    after, weight = right_profile(memory)
    far_behind = (ObservationMemory(1).settings.places < -0.3) & (weight > 0.3)
    assert far_behind.sum() >= 8
    assert after[far_behind] == pytest.approx(before[far_behind] + 0.1, abs=0.01)


def test_side_sonars_of_a_turned_car_are_ignored():
    memory = ObservationMemory(1)
    memory.reset(ONE)
    memory.update(ONE, observation(turn=0.5, right=0.2))
    assert np.all(right_profile(memory)[1] == 0.0)


def test_no_answer_has_no_weight_and_no_echo_little():
    dead, silent, sure = (passed([0.2] * 5, echo=echo) for echo in (-1.0, 0.0, 1.0))
    place = np.argmin(np.abs(ObservationMemory(1).settings.places))
    assert right_profile(silent)[1][place] < right_profile(sure)[1][place]
    assert right_profile(dead)[1][place] <= right_profile(silent)[1][place]


def test_readings_are_weighted_by_credence():
    memory = ObservationMemory(1)
    memory.reset(ONE)
    memory.update(ONE, observation(right=0.2, credence=1.0))
    memory.update(ONE, observation(right=0.8, credence=0.0))
    place = np.argmin(np.abs(memory.settings.places))
    assert right_profile(memory)[0][place] == pytest.approx(0.1 + (0.2 + 0.1 * 0.8) / 1.1, abs=0.01)


def test_features_without_credence_do_not_depend_on_it():
    settings = MemorySettings(credence=False)
    shown = []
    for credence in (0.1, 0.9):
        memory = ObservationMemory(1, settings=settings)
        memory.reset(ONE)
        for k in range(5):
            memory.update(ONE, observation(x=GRID_STEP * k, right=0.2 + 0.1 * k, credence=credence))
        shown.append(memory.features(ONE))
    assert np.array_equal(*shown)


def test_travel_is_measured_from_the_last_reversal():
    memory = ObservationMemory(1)
    memory.reset(ONE)
    for x in np.r_[np.arange(0.0, 0.5, 0.02), np.arange(0.48, 0.3, -0.02)]:
        memory.update(ONE, observation(x=x))
    assert memory.travel[0] == pytest.approx(0.32 - 0.48, abs=0.011)


def test_small_motions_are_no_reversal():
    memory = ObservationMemory(1)
    memory.reset(ONE)
    for x in (0.1, 0.2, 0.2, 0.199, 0.2, 0.201):
        memory.update(ONE, observation(x=x))
    assert memory.travel[0] > 0.19


def test_reset_clears_one_car_and_no_other():
    memory = ObservationMemory(2)
    both = np.arange(2)
    memory.reset(both)
    fresh = memory.features(both)
    for k in range(30):
        memory.update(both, observation(x=GRID_STEP * k, right=0.3, n=2))
    before = memory.features(both)
    memory.reset(np.array([0]))
    assert np.array_equal(memory.features(both)[0], fresh[0])
    assert np.array_equal(memory.features(both)[1], before[1])


def test_features_of_many_cars_equal_those_of_each_alone():
    n = 5
    envs = SonarParkingVectorEnv(n, sonar="gaussian", threads=1)
    together, apart = ObservationMemory(n), [ObservationMemory(1) for _ in range(n)]
    seen, _ = envs.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(40):
        together.update(np.arange(n), seen)
        for i, memory in enumerate(apart):
            memory.update(ONE, {name: value[i : i + 1] for name, value in seen.items()})
        seen, *_ = envs.step(rng.uniform(0.0, 1.0, (n, 2)) * [0.2, 1.0])
    assert np.array_equal(together.features(np.arange(n)), np.concatenate([memory.features(ONE) for memory in apart]))
    assert np.abs(together.features(np.arange(n))).max() <= 10.0
    envs.close()


@pytest.mark.parametrize("wrong", [{"lags": 0}, {"coarse": 0}, {"behind": -1.0}, {"ahead": 9.0}])
def test_invalid_settings_raise(wrong):
    with pytest.raises(SettingError, match="MemorySettings"):
        MemorySettings(**wrong)
