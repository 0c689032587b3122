"""What can be fixed: street, boxes, start, difficulty; and sonars that fire in turn and answer late."""

import gymnasium
import numpy as np
import pytest

import sonar_gym
from acquisition import SettingError
from noise import GaussianModel
from noise.faults import Constant, Faulty
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.parking.street import LEVELS, StreetSettings, draw_street, reference_path
from sonar_gym.parking.vehicle import CarSettings
from sonar_gym.sensing.kernels import touches
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.sensing.scene import Scene, WallSegment

BOXES = [{"begin": 0.6, "length": 0.3}, {"begin": 1.9, "length": 0.3, "reflectance": 0.8, "texture_deg": 5.0}]
AT_ONCE = {"acceleration": 1e9, "speed_lag": 0.0}  # a car that goes 0.5 m/s from the first moment on
LINE_UP = {"start_offset": 0.0, "start_heading_deg": 0.0}


def nose(**timing):
    """Return a layout of one sonar that looks straight ahead through a pencil of 2 deg, 0.36 m before the axle."""
    return [{"name": "nose", "x": 0.36, "y": 0.0, "heading_deg": 0.0, "cone_deg": 2.0, **timing}]


# ---- options of reset ------------------------------------------------------------------------------------------------


def test_boxes_stand_where_they_are_wanted():
    env = SonarParkingEnv()
    env.reset(seed=0, options={"boxes": BOXES})
    assert [(box.x, box.length, box.reflectance) for box in env.street.boxes] == [
        (pytest.approx(0.75), 0.3, 0.5),
        (pytest.approx(2.05), 0.3, 0.8),
    ]
    assert env.street.gap == (pytest.approx(0.9), 1.9)
    assert env.street.end == pytest.approx(2.2 + env.street.settings.tail)
    assert np.array_equal(env.car.pose, np.zeros(3))


def test_the_car_starts_where_it_is_wanted_and_its_odometer_at_zero():
    env = SonarParkingEnv()
    observation, _ = env.reset(seed=0, options={"start": [0.4, 0.02, 0.1]})
    assert list(env.car.pose) == [0.4, 0.02, 0.1]
    assert list(observation["ego"]) == [0, 0, 1, 0, 0, 0, 0]


def test_a_street_is_used_again_and_options_hold_for_one_episode():
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


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"fog": 1}, "reset option 'fog': no such option; expected difficulty, street, boxes, start"),
        ({"start": [0, 0]}, "reset option 'start' must be x, y, heading"),
        ({"start": [0, np.nan, 0]}, "reset option 'start' must be x, y, heading"),
        ({"boxes": [{"begin": 1.0, "length": 1.0}]}, "boxes must be two or more"),
        ({"boxes": [{"begin": 1.0, "length": 1.0}, {"begin": 1.5, "length": 1.0}]}, "boxes overlap"),
        ({"boxes": [{"begin": 1.0, "width": 1.0}]}, "boxes: no field 'width'; expected begin, length"),
        ({"difficulty": "absurd"}, "difficulty 'absurd': no such level; expected easy, normal, hard"),
    ],
)
def test_options_that_make_no_sense_are_refused_by_name(options, words):
    with pytest.raises(SettingError, match=words):
        SonarParkingEnv().reset(seed=0, options=options)


# ---- difficulty ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", LEVELS)
def test_every_level_can_be_mastered(level):
    car = CarSettings()
    for seed in range(40):
        street = draw_street(LEVELS[level], np.random.default_rng(seed))
        path = reference_path(street, car)[:, :3]
        ahead = path[path[:, 0] > street.start[0]]
        assert all(touches(pose, car.body, street.scene.segments) == -1 for pose in ahead.copy())
        spaces = street.strip[1:, 0] - street.strip[:-1, :2].sum(axis=1)
        own = np.isclose(spaces, street.gap[1] - street.gap[0])
        assert own.sum() == 1
        assert np.all(spaces[~own] < LEVELS[level].gap[0])


def test_levels_grow_harder():
    room = [LEVELS[level].gap[0] - LEVELS[level].decoy[1] for level in ("easy", "normal", "hard")]
    gap = [np.mean(LEVELS[level].gap) for level in ("easy", "normal", "hard")]
    assert room == sorted(room, reverse=True)
    assert gap == sorted(gap, reverse=True)
    env = gymnasium.make(sonar_gym.ENV_ID, difficulty="hard")
    assert env.unwrapped.fleet.street_settings == LEVELS["hard"]


# ---- texture and causes ----------------------------------------------------------------------------------------------


def test_facets_of_a_rough_face_turn_oblique_sound_back():
    # axis 20 deg off the normal of a wall, half cone 5 deg: the nearest point in the cone lies 15 deg off the normal
    pose, half = np.array([[0.0, 0.0, np.radians(20.0)]]), np.array([np.radians(5.0)])
    for texture, met in ((0.0, 15.0), (10.0, 5.0), (25.0, 0.0)):
        hits = Scene([WallSegment(1.0, -50.0, 1.0, 50.0, texture_deg=texture)]).cast(pose, half, 3.0)
        assert np.degrees(hits.incidence[0]) == pytest.approx(met, abs=1e-6)
        assert np.degrees(hits.bearing[0]) == pytest.approx(-5.0)


def test_texture_reaches_the_sonar_s_law():
    met = []
    for texture in (0.0, 30.0):
        env = SonarParkingEnv(street={**LINE_UP, "texture_deg": (texture, texture)})
        _, info = env.reset(seed=3)
        met.append(info["incidence"])
    assert np.all(met[1] <= met[0])
    assert np.any(met[1] < met[0])


def test_the_cause_of_every_reading_is_told():
    stuck = Faulty(GaussianModel(sigma=1e-4, sigma_per_metre=0.0, miss=0.3), [Constant(rate=0.25, value=0.5)])
    env, told = SonarParkingEnv(sonar=stuck), []
    observation, info = env.reset(seed=0)
    for _ in range(300):
        told += [(env.causes[k], float(r)) for k, r in zip(info["cause"], observation["ranges"], strict=True)]
        for i, name in enumerate(env.causes[k] for k in info["cause"]):
            assert (observation["echo"][i] == 1) == (name in ("target", "CONSTANT"))
            if name == "target":
                assert observation["ranges"][i] * MAX_RANGE == pytest.approx(info["distance"][i], rel=0.1)
            if name in ("missed", "empty"):
                assert info["in_cone"][i] == (name == "missed")
        observation, _, _, _, info = env.step(np.zeros(2))
    names = [name for name, _ in told]
    assert all(said == pytest.approx(0.5 / MAX_RANGE) for name, said in told if name == "CONSTANT")
    assert names.count("CONSTANT") / len(names) == pytest.approx(0.25, abs=0.03)
    heard = names.count("target") + names.count("missed")
    assert names.count("missed") / heard == pytest.approx(0.3, abs=0.04)


# ---- cadence ---------------------------------------------------------------------------------------------------------


def test_readings_are_of_the_moment_of_their_pings_and_come_in_after_their_latency():
    # pings at 0.05, 0.35, 0.65 s, readings 0.06 s later; at 0.5 m/s, from a wall 3.2 m before the axle's start
    layout = nose(period_s=0.3, phase_s=0.05, latency_s=0.06)
    env = SonarParkingEnv(sonar_layout=layout, car=AT_ONCE)
    observation, info = env.reset(seed=0, options={"boxes": BOXES})
    for step, sent in enumerate([0.0, 0.0, 0.05, 0.05, 0.05, 0.35, 0.35, 0.35, 0.65]):
        away = 3.2 - 0.36 - 0.5 * sent
        assert info["distance"][0] == pytest.approx(away, abs=1e-9)
        assert observation["ranges"][0] * MAX_RANGE == pytest.approx(away, abs=0.0005 + 1e-6)
        assert observation["age"][0] == pytest.approx(0.1 * step - sent, abs=1e-6)
        observation, _, _, _, info = env.step(np.array([0.0, 1.0]))


def test_without_a_period_every_reading_is_fresh():
    env = SonarParkingEnv(sonar_layout=nose(), car=AT_ONCE)
    env.reset(seed=0, options={"boxes": BOXES})
    for step in range(1, 6):
        observation, _, _, _, info = env.step(np.array([0.0, 1.0]))
        assert observation["age"][0] == 0.0
        assert info["distance"][0] == pytest.approx(3.2 - 0.36 - 0.05 * step, abs=1e-9)


def test_neighbours_in_turn_never_fire_together():
    mounts = LAYOUTS["eight in turn"]
    for i, a in enumerate(mounts):
        for b in mounts[i + 1 :]:
            apart = abs((a.heading_deg - b.heading_deg + 180.0) % 360.0 - 180.0)
            if apart < 0.5 * (a.cone_deg + b.cone_deg):
                between = abs(a.phase_s - b.phase_s)
                assert min(between, a.period_s - between) >= 0.02 - 1e-9  # an SRF08 listens for 17.6 ms


@pytest.mark.parametrize(
    ("timing", "words"),
    [
        ({"period_s": 0.05}, "period_s of 'nose' is 0.05 s, less than the 0.1 s"),
        ({"latency_s": 0.2}, "latency_s of 'nose' is 0.2 s, more than the 0.1 s to its next ping"),
        ({"period_s": 0.2, "latency_s": 0.3}, "more than its period of 0.2 s"),
        ({"phase_s": -1.0}, "phase_s of 'nose' must be >= 0 s"),
    ],
)
def test_times_that_cannot_be_are_refused(timing, words):
    with pytest.raises(SettingError, match=words):
        SonarParkingEnv(sonar_layout=nose(**timing))


def test_the_world_does_not_depend_on_layout_or_cadence():
    cars = []
    for layout in ("eight", "four", "eight in turn", nose(period_s=0.3)):
        env = SonarParkingEnv(sonar_layout=layout)
        env.reset(seed=4)
        for _ in range(20):
            env.step(np.array([0.1, 0.6]))
        cars.append((env.street.gap, tuple(env.car.state)))
    assert len(set(cars)) == 1


def test_settings_of_a_street_are_checked():
    with pytest.raises(SettingError, match="texture_deg must be < 90 deg"):
        StreetSettings(texture_deg=(0.0, 95.0))
    with pytest.raises(SettingError, match=r"kerb_reflectance must lie in \[0, 1\], got 1.2"):
        StreetSettings(kerb_reflectance=1.2)
