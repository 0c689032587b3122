"""Options of reset, difficulty, texture, causes, and the timing of sonars."""

import gymnasium
import numpy as np
import pytest

import sonar_gym
from acquisition import SettingError
from noise import ComposedModel, GaussianModel
from noise.faults import Constant, Faulty
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.sensing.kernels import touches
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.sensing.scene import Scene, WallSegment
from sonar_gym.sensing.timing import sensor_latency
from sonar_gym.street.street import LEVELS, StreetSettings, draw_street
from sonar_gym.street.vehicle import CarSettings
from tests.sonar_gym.parking.reference import reference_path

BOXES = [{"begin": 0.6, "length": 0.3}, {"begin": 1.9, "length": 0.3, "reflectance": 0.8, "texture_deg": 5.0}]
NO_LAG = {"acceleration": 1e9, "speed_lag": 0.0}  # the car reaches 0.5 m/s at once
ALIGNED = {"start_offset": 0.0, "start_heading_deg": 0.0}


def nose(**timing):
    """Return a layout of one sonar, 0.36 m before the rear axle, straight ahead, with a cone of 2 deg."""
    return [{"name": "nose", "x": 0.36, "y": 0.0, "heading_deg": 0.0, "cone_deg": 2.0, **timing}]


# ---- options of reset ------------------------------------------------------------------------------------------------


def test_boxes_are_placed_as_given():
    env = SonarParkingEnv()
    env.reset(seed=0, options={"boxes": BOXES})
    assert [(box.x, box.length, box.reflectance) for box in env.street.boxes] == [
        (pytest.approx(0.75), 0.3, 0.5),
        (pytest.approx(2.05), 0.3, 0.8),
    ]
    assert env.street.gap == (pytest.approx(0.9), 1.9)
    assert env.street.end == pytest.approx(2.2 + env.street.settings.tail)
    assert np.array_equal(env.car.pose, np.zeros(3))


def test_the_car_starts_as_given_with_its_odometry_at_zero():
    env = SonarParkingEnv()
    observation, _ = env.reset(seed=0, options={"start": [0.4, 0.02, 0.1]})
    assert list(env.car.pose) == [0.4, 0.02, 0.1]
    assert list(observation["ego"]) == [0, 0, 1, 0, 0, 0, 0]


def test_a_start_turned_by_a_whole_turn_has_the_same_rewards():
    rewards = []
    for turn in (0.0, 2.0 * np.pi):
        env = SonarParkingEnv()
        env.reset(seed=0, options={"start": [0.0, 0.0, turn]})
        rewards.append([env.step(np.array([0.1, 1.0]))[1] for _ in range(5)])
    assert rewards[0] == pytest.approx(rewards[1], abs=1e-9)


def test_a_street_can_be_reused_and_options_apply_to_one_episode():
    env = SonarParkingEnv()
    env.reset(seed=0)
    street = env.street
    env.reset(seed=1)
    assert env.street.gap != street.gap
    env.reset(options={"street": street})
    assert env.street is street
    env.reset()
    assert env.street.gap != street.gap


def test_fields_of_the_street_are_replaced():
    env = SonarParkingEnv(difficulty="hard")
    env.reset(seed=0, options={"street": {"decoys": (3, 3)}})
    assert len(env.street.boxes) == 5
    assert env.street.settings.gap == LEVELS["hard"].gap


def test_settings_that_nothing_replaces_are_not_checked_again():
    env = SonarParkingEnv(difficulty="hard")
    env.reset(seed=0)
    assert env.street.settings is env.fleet.street_settings


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fog": 1}, "reset option 'fog': unknown option; expected difficulty, street, boxes, obstacles, start"),
        ({"start": [0, 0]}, "reset option 'start' must be x, y, heading"),
        ({"start": [0, np.nan, 0]}, "reset option 'start' must be x, y, heading"),
        ({"boxes": [{"begin": 1.0, "length": 1.0}]}, "boxes must be two or more"),
        ({"boxes": [{"begin": 1.0, "length": 1.0}, {"begin": 1.5, "length": 1.0}]}, "boxes overlap"),
        ({"boxes": [{"begin": 1.0, "width": 1.0}]}, "boxes: unknown field 'width'; expected begin, length"),
        ({"difficulty": "absurd"}, "difficulty: expected one of easy, normal, hard, manoeuvre, got 'absurd'"),
    ],
)
def test_invalid_options_raise_an_error(options, message):
    with pytest.raises(SettingError, match=message):
        SonarParkingEnv().reset(seed=0, options=options)


def test_further_obstacles_are_heard_by_their_material_and_hit():
    heard = {}
    for kind in ("pole", "hedge", "wall"):
        place = {"kind": kind, "x": 1.2, "y": 0.0, "heading": 0.3} | ({} if kind == "pole" else {"length": 0.3})
        place |= {"width": 0.2} if kind == "hedge" else {}
        env = SonarParkingEnv()
        _, info = env.reset(seed=0, options={"boxes": BOXES, "obstacles": [place]})
        assert info["obstacle"][0] == len(env.street.boxes) + 3
        heard[kind] = info["reflectance"][0]
        ended = [env.step(np.array([0.0, 1.0]))[4]["collision"] for _ in range(25)]
        assert any(ended)
    assert heard == {"pole": 0.1, "hedge": 0.2, "wall": 0.9}
    with pytest.raises(SettingError, match="one of pole, hedge, wall, pedestrian, car, got 'cloud'"):
        SonarParkingEnv().reset(seed=0, options={"obstacles": [{"kind": "cloud", "x": 1.0, "y": 0.0}]})


# ---- difficulty ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", [level for level in LEVELS if level != "manoeuvre"])  # which needs several moves
def test_the_reference_path_of_every_level_is_free_of_contact(level):
    car = CarSettings()
    for seed in range(40):
        street = draw_street(LEVELS[level], np.random.default_rng(seed))
        path = reference_path(street, car)[:, :3]
        ahead, segments = path[path[:, 0] > street.start[0]], street.scene.segments
        assert all(touches(pose, car.body, segments) == -1 for pose in ahead.copy())
        spaces = street.strip[1:, 0] - street.strip[:-1, :2].sum(axis=1)
        is_gap = np.isclose(spaces, street.gap[1] - street.gap[0])
        assert is_gap.sum() == 1
        assert np.all(spaces[~is_gap] < LEVELS[level].gap[0])


def test_levels_are_ordered_by_difficulty():
    room = [LEVELS[level].gap[0] - LEVELS[level].decoy[1] for level in ("easy", "normal", "hard")]
    gap = [np.mean(LEVELS[level].gap) for level in ("easy", "normal", "hard")]
    assert room == sorted(room, reverse=True)
    assert gap == sorted(gap, reverse=True)
    env = gymnasium.make(sonar_gym.ENV_ID, difficulty="hard")
    assert env.unwrapped.fleet.street_settings == LEVELS["hard"]


# ---- texture and causes ----------------------------------------------------------------------------------------------


def test_slope_of_facets_reduces_the_incidence():
    # axis 20 deg off the normal of a wall, half cone 5 deg: the nearest point in the cone is 15 deg off the normal
    pose, half = np.array([[0.0, 0.0, np.radians(20.0)]]), np.array([np.radians(5.0)])
    for texture, incidence in ((0.0, 15.0), (10.0, 5.0), (25.0, 0.0)):
        hits = Scene([WallSegment(1.0, -50.0, 1.0, 50.0, texture_deg=texture)]).cast(pose, half, 3.0)
        assert np.degrees(hits.incidence[0]) == pytest.approx(incidence, abs=1e-6)
        assert np.degrees(hits.bearing[0]) == pytest.approx(-5.0)


def test_texture_reduces_the_incidence_given_to_the_model():
    incidence = []
    for texture in (0.0, 30.0):
        env = SonarParkingEnv(street={**ALIGNED, "texture_deg": (texture, texture)})
        _, info = env.reset(seed=3)
        incidence.append(info["incidence"])
    assert np.all(incidence[1] <= incidence[0])
    assert np.any(incidence[1] < incidence[0])


@pytest.mark.parametrize("made", [lambda faulty: faulty, lambda faulty: ComposedModel(faulty, [], [])])
def test_info_has_the_cause_of_every_reading(made):
    sonar = made(Faulty(GaussianModel(sigma=1e-4, sigma_per_metre=0.0, miss=0.3), [Constant(rate=0.25, value=0.5)]))
    narrow = [{**nose()[0], "name": str(k), "heading_deg": 45.0 * k} for k in range(8)]  # at most one reflector each
    env, readings = SonarParkingEnv(sonar=sonar, sonar_layout=narrow, credence_driver=None), []
    observation, info = env.reset(seed=0)
    for _ in range(300):
        readings += [(env.causes[k], float(r)) for k, r in zip(info["cause"], observation["ranges"], strict=True)]
        for i, name in enumerate(env.causes[k] for k in info["cause"]):
            assert (observation["echo"][i] == 1) == (name in ("target", "CONSTANT"))
            if name == "target":
                assert observation["ranges"][i] * MAX_RANGE == pytest.approx(info["distance"][i], rel=0.1)
            if name in ("missed", "empty"):
                assert info["in_cone"][i] == (name == "missed")
        observation, _, _, _, info = env.step(np.zeros(2))
    names = [name for name, _ in readings]
    assert all(reading == pytest.approx(0.5 / MAX_RANGE) for name, reading in readings if name == "CONSTANT")
    assert names.count("CONSTANT") / len(names) == pytest.approx(0.25, abs=0.03)
    with_target = names.count("target") + names.count("missed")
    assert names.count("missed") / with_target == pytest.approx(0.3, abs=0.04)


# ---- timing ----------------------------------------------------------------------------------------------------------


def test_readings_belong_to_the_time_of_their_pings_and_arrive_after_the_latency():
    # pings at 0.05, 0.35, 0.65 s, readings 0.06 s later; at 0.5 m/s, towards a wall 3.2 m before the start of the axle
    layout = nose(period_s=0.3, phase_s=0.05, latency_s=0.06)
    env = SonarParkingEnv(sonar_layout=layout, car=NO_LAG)
    observation, info = env.reset(seed=0, options={"boxes": BOXES})
    for step, sent in enumerate([0.0, 0.0, 0.05, 0.05, 0.05, 0.35, 0.35, 0.35, 0.65]):
        distance = 3.2 - 0.36 - 0.5 * sent
        assert info["distance"][0] == pytest.approx(distance, abs=1e-9)
        assert observation["ranges"][0] * MAX_RANGE == pytest.approx(distance, abs=0.0005 + 1e-6)
        assert observation["age"][0] == pytest.approx(0.1 * step - sent, abs=1e-6)
        observation, _, _, _, info = env.step(np.array([0.0, 1.0]))


@pytest.mark.parametrize("latency_s", [0.0, 0.03])
def test_without_a_period_readings_arrive_with_the_observation(latency_s):
    env = SonarParkingEnv(sonar_layout=nose(latency_s=latency_s), car=NO_LAG)
    env.reset(seed=0, options={"boxes": BOXES})
    for step in range(1, 6):
        observation, _, _, _, info = env.step(np.array([0.0, 1.0]))
        assert observation["age"][0] == pytest.approx(latency_s, abs=1e-6)
        assert info["distance"][0] == pytest.approx(3.2 - 0.36 - 0.5 * (0.1 * step - latency_s), abs=1e-9)


def test_the_default_latency_is_that_of_an_srf08():
    # 65 ms for 11 m (Devantech, SRF08); 3.01 m there and back at 343 m/s takes 17.6 ms, and the bus 2 ms
    env = SonarParkingEnv(sonar_layout=nose())
    env.reset(seed=0)
    assert env.step(np.zeros(2))[0]["age"][0] == pytest.approx(0.0196, abs=2e-4)
    assert sensor_latency(11.0) == pytest.approx(0.065, abs=2e-3)
    assert SonarParkingEnv(sonar_layout="eight without latency").fleet.sensing.timing[:, 2].max() == 0.0


def test_neighbours_never_fire_together_in_turn():
    mounts = LAYOUTS["eight in turn"]
    for i, a in enumerate(mounts):
        for b in mounts[i + 1 :]:
            apart = abs((a.heading_deg - b.heading_deg + 180.0) % 360.0 - 180.0)
            if apart < 0.5 * (a.cone_deg + b.cone_deg):
                between = abs(a.phase_s - b.phase_s)
                assert min(between, a.period_s - between) >= 0.02 - 1e-9  # the sound of an SRF08 takes 17.6 ms


@pytest.mark.parametrize(
    ("timing", "message"),
    [
        ({"period_s": 0.05}, "period_s of 'nose' is 0.05 s, less than the 0.1 s"),
        ({"period_s": 0.2, "latency_s": 0.3}, "more than its period of 0.2 s"),
        ({"phase_s": -1.0}, "phase_s of 'nose': expected a number from 0 "),
    ],
)
def test_invalid_times_raise_an_error(timing, message):
    with pytest.raises(SettingError, match=message):
        SonarParkingEnv(sonar_layout=nose(**timing))


def test_the_world_does_not_depend_on_layout_or_timing():
    cars = []
    for layout in ("eight", "four", "eight in turn", nose(period_s=0.3)):
        env = SonarParkingEnv(sonar_layout=layout)
        env.reset(seed=4)
        for _ in range(20):
            env.step(np.array([0.1, 0.6]))
        cars.append((env.street.gap, tuple(env.car.state)))
    assert len(set(cars)) == 1


def test_invalid_street_settings_raise_an_error():
    with pytest.raises(SettingError, match="texture_deg: expected a number of at least 0 and below 90 deg"):
        StreetSettings(texture_deg=(0.0, 95.0))
    with pytest.raises(SettingError, match=r"kerb_reflectance: expected a number from 0 to 1, got 1.2"):
        StreetSettings(kerb_reflectance=1.2)
