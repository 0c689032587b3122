"""Every invalid option has one clear error, before anything is drawn."""

import numpy as np
import pytest

from acquisition import SettingError
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sb3 import SonarVecEnv
from sonar_gym.street.street import StreetSettings, draw_street

NOSE = {"name": "nose", "x": 0.36, "y": 0.0, "heading_deg": 0.0}
BOXES = [{"begin": 0.6, "length": 0.3}, {"begin": 1.9, "length": 0.3}]
ARGUMENTS = {
    "gap shorter than the car": ({"street": {"gap": (0.44, 0.9), "decoy": (0.1, 0.2)}}, "gap is 0.44 m .* car 0.45 m"),
    "car longer than the gap": ({"car": {"length": 0.9}}, "gap is 0.85 m long, but the car 0.9 m"),
    "infinite reward": ({"reward": {"parked": np.inf}}, "reward.parked: expected a number .*, got inf"),
    "reward that is not a number": ({"reward": {"time": np.nan}}, "reward.time: expected a number .*, got nan"),
    "unknown reward": ({"reward": {"comfort": 1.0}}, "reward: unknown field 'comfort'; expected potential"),
    "discount above 1": ({"reward": {"discount": 1.1}}, "reward.discount: expected a number .*, got 1.1"),
    "unknown field of the street": ({"street": {"fog": 1.0}}, "street: unknown field 'fog'; expected gap"),
    "infinite street": ({"street": {"tail": np.inf}}, "street.tail: expected a number .*, got inf"),
    "infinite pair": ({"street": {"recess": (0.0, np.inf)}}, "street.recess: expected a number .*, got inf"),
    "negative depth": ({"street": {"depth": -1.0}}, "street.depth: expected a number above 0 .*, got -1 m"),
    "unknown measure": ({"car": {"doors": 4}}, "car: unknown field 'doors'"),
    "infinite measure": (
        {"car": {"rear_overhang": np.inf}},
        "car.rear_overhang: expected .*, got inf",
    ),
    "unknown odometry": ({"odometry": {"drift": 1.0}}, "odometry: unknown field 'drift'"),
    "odometry of a wrong type": ({"odometry": 3}, "expected OdometrySettings or a mapping of its fields, got 3"),
    "no sonars": ({"sonar_layout": []}, "sonar_layout has 0 mounts"),
    "unknown field of a mount": ({"sonar_layout": [{**NOSE, "z": 1.0}]}, "sonar_layout: unknown field 'z'"),
    "missing field of a mount": ({"sonar_layout": [{"name": "nose"}]}, "sonar_layout: .*missing"),
    "mount that is nowhere": (
        {"sonar_layout": [{**NOSE, "x": np.nan}]},
        "sonar_layout.x of 'nose': expected .*, got nan",
    ),
    "negative period": (
        {"sonar_layout": [{**NOSE, "period_s": -0.1}]},
        "sonar_layout.period_s of 'nose': expected",
    ),
    "unknown driver": ({"credence_driver": "taxi"}, "credence_driver: expected one of agent, scripted, random, got"),
}
OPTIONS = {
    "start in a box": ({"boxes": BOXES, "start": [0.75, -0.45, 0.0]}, "'start': a car at x 0.75 m, y -0.45 m touches"),
    "start outside": ({"boxes": BOXES, "start": [0.0, 5.0, 0.0]}, "y 5 m, outside the street: x from -1.5 to 3.2 m"),
    "infinite start": ({"start": [np.inf, 0.0, 0.0]}, "'start' must be x, y, heading"),
    "boxes that overlap": ({"boxes": [BOXES[0], {"begin": 0.7, "length": 0.3}]}, "boxes overlap"),
    "gap between boxes": ({"boxes": [BOXES[0], {"begin": 1.2, "length": 0.3}]}, "gap is 0.3 m long, but the car 0.45"),
    "infinite box": ({"boxes": [BOXES[0], {"begin": np.inf, "length": 0.3}]}, "boxes must have finite fields"),
    "unknown field": ({"street": {"fog": 1.0}}, "street: unknown field 'fog'"),
    "street of a wrong type": ({"street": 3}, "'street' must be a Street, StreetSettings or a mapping .* got a int"),
}
UNFIT = [
    ("max_episode_steps", -1, "max_episode_steps: expected .*, got -1"),
    ("render_mode", "rgb_array", "'render_mode' cannot be set; expected max_episode_steps, pictured, street_settings"),
    ("pictured", [2], r"pictured: expected at most 2 numbers of environments below 2, got \[2\]"),
    ("pictured", range(10**15), r"pictured: expected at most 2 numbers .* got range\(0, 1000000000000000\)"),
    ("street_settings", 3, "street_settings: expected StreetSettings or a mapping of its fields, got 3"),
]


@pytest.mark.parametrize(("arguments", "message"), ARGUMENTS.values(), ids=ARGUMENTS)
def test_invalid_arguments_raise_an_error(arguments, message):
    for make in (SonarParkingEnv, SonarParkingVectorEnv):
        with pytest.raises(SettingError, match=message):
            make(**arguments)


@pytest.mark.parametrize(("options", "message"), OPTIONS.values(), ids=OPTIONS)
def test_invalid_options_raise_an_error_and_leave_the_episode_alone(options, message):
    single, many = SonarParkingEnv(), SonarParkingVectorEnv(2, threads=1)
    for env in (single, many):
        env.reset(seed=0)
        street, state = env.fleet.streets[0], env.fleet.sonar.rngs[0].bit_generator.state
        with pytest.raises(SettingError, match=message):
            env.reset(seed=1, options=options)
        assert env.fleet.streets[0] is street
        assert env.fleet.sonar.rngs[0].bit_generator.state == state


def test_a_start_on_a_street_that_is_drawn_is_checked_against_it():
    env = SonarParkingEnv()
    with pytest.raises(SettingError, match="touches an obstacle: move the start"):
        env.reset(seed=0, options={"start": [0.75, -0.3, 0.0]})


def test_given_streets_are_used_as_they_are():
    street = draw_street(StreetSettings(), np.random.default_rng(1))
    env = SonarParkingEnv()
    env.reset(seed=0, options={"street": street, "start": [0.1, 0.0, 0.0]})
    assert env.street.gap == street.gap
    assert env.car.pose[0] == 0.1


def test_attributes_that_have_no_effect_cannot_be_set():
    envs = SonarVecEnv(2)
    with pytest.raises(SettingError, match="'sonar' cannot be set; expected max_episode_steps, pictured"):
        envs.set_attr("sonar", "gaussian")
    envs.set_attr("max_episode_steps", 3)
    for name, value, message in UNFIT:
        with pytest.raises(SettingError, match=message):
            envs.set_attr(name, value)
    envs.reset()
    ended = [envs.step(np.zeros((2, 2)))[2].tolist() for _ in range(3)]
    assert ended == [[False, False], [False, False], [True, True]]
