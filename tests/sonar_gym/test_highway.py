"""Cones in highway-env's scenes: walls by hand, shapely as a second opinion, and the world left alone."""

import gymnasium
import numpy as np
import pytest
from shapely import Point, Polygon
from shapely.geometry import box as rectangle

from acquisition import SettingError
from sonar_gym.highway import ROAD_LAYOUT, HighwaySonar, box_of, solid_things, upright
from sonar_gym.mounts import Mount, in_world, mount_arrays

highway_env = pytest.importorskip("highway_env")
AHEAD = [Mount("front", 2.5, 0.0, 0.0), Mount("left", 0.0, 1.0, 90.0), Mount("right", 0.0, -1.0, -90.0)]


def parking(**settings):
    return HighwaySonar(gymnasium.make("parking-v0"), **settings)


def put(env, x, y, heading):
    """Stand the car somewhere, in highway-env's own frame."""
    vehicle = env.unwrapped.vehicle
    vehicle.position, vehicle.heading = np.array([x, y], dtype=float), heading


def test_wall_ahead_is_seen_though_its_centre_is_far():
    env = parking(sonar_layout=AHEAD)
    env.reset(seed=0)
    put(env, 20.0, -16.0, -np.pi / 2)  # nose to the upper wall, whose face lies at y = -20.5 and centre 20 m away
    hits = env.look()
    assert hits.distance[0] == pytest.approx(20.5 - 16.0 - 2.5)
    assert hits.incidence[0] == pytest.approx(0.0, abs=1e-9)
    put(env, 0.0, 0.0, 0.0)
    assert not env.look().seen.any()


def test_left_is_left():
    env = parking(sonar_layout=AHEAD)
    env.reset(seed=0)
    put(env, 0.0, -17.0, 0.0)  # driving right along the upper wall: the wall is on the left
    hits = env.look()
    assert list(hits.seen) == [False, True, False]
    assert hits.distance[1] == pytest.approx(20.5 - 17.0 - 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_cones_agree_with_shapely_on_a_crowded_road(seed):
    env = HighwaySonar(gymnasium.make("highway-v0", config={"vehicles_density": 3}), max_range=30.0)
    env.reset(seed=seed)
    base = env.unwrapped
    hits, (local, half) = env.look(), mount_arrays(ROAD_LAYOUT)
    poses = in_world(local, upright(base.vehicle))
    bodies = [Polygon(box_of(thing, 0.5).corners) for thing in solid_things(base.road, base.vehicle)]
    for i, (pose, opening) in enumerate(zip(poses, half, strict=True)):
        angles = np.linspace(pose[2] - opening, pose[2] + opening, 400)
        arc = np.column_stack([pose[0] + 30.0 * np.cos(angles), pose[1] + 30.0 * np.sin(angles)])
        inside = [body.intersection(Polygon([pose[:2], *arc])) for body in bodies]
        near = [Point(pose[:2]).distance(part) for part in inside if not part.is_empty]
        assert hits.seen[i] == bool(near)
        if near:
            assert hits.distance[i] == pytest.approx(min(near), abs=1e-3)


def test_boxes_of_the_road_have_its_measures():
    env = parking()
    env.reset(seed=0)
    walls = solid_things(env.unwrapped.road, env.unwrapped.vehicle)
    assert sorted(max(wall.LENGTH, wall.WIDTH) for wall in walls) == [42, 42, 70, 70]  # the landmark is not solid
    upper = Polygon(box_of(walls[0], 0.5).corners)
    assert upper.symmetric_difference(rectangle(-35.0, 20.5, 35.0, 21.5)).area == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("name", "key"), [("parking-v0", "achieved_goal"), ("highway-v0", "base")])
def test_observation_holds_both_and_stays_inside_its_space(name, key):
    env = HighwaySonar(gymnasium.make(name), "gaussian")
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    for _ in range(5):
        assert {key, "ranges", "credence", "echo"} <= set(observation)
        for part in ("ranges", "credence", "echo"):
            assert observation[part] in env.observation_space[part]
        observation, _, terminated, _, info = env.step(env.action_space.sample())
        assert np.all(observation["echo"][~info["sonar"]["in_cone"]] == 0.0)
        if terminated:
            break


def test_world_is_the_same_with_and_without():
    bare, wrapped = gymnasium.make("parking-v0"), parking(sonar="gaussian")
    for seed in (1, None):
        first, second = bare.reset(seed=seed)[0], wrapped.reset(seed=seed)[0]
        assert np.array_equal(first["observation"], second["observation"])
        assert np.array_equal(first["desired_goal"], second["desired_goal"])


def test_same_seed_same_readings():
    first, second = (parking(sonar="gaussian").reset(seed=9)[0]["ranges"] for _ in range(2))
    assert np.array_equal(first, second)


def test_spec_goes_through_json():
    env = parking(sonar="gaussian", sonar_layout=AHEAD, max_range=4.0)
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.get_wrapper_attr("mounts") == tuple(AHEAD)
    assert again.observation_space["ranges"].shape == (3,)


def test_other_environments_are_refused():
    with pytest.raises(SettingError, match="HighwaySonar needs an environment of highway-env, got CartPoleEnv"):
        HighwaySonar(gymnasium.make("CartPole-v1"))
    with pytest.raises(SettingError, match=r"HighwaySonar.max_range must be > 0 m, got 0 m"):
        parking(max_range=0.0)
