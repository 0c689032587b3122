"""SonarObservation in highway-env: cones against known walls and against shapely, and the retained observations."""

import gymnasium
import numpy as np
import pytest
from shapely import Point, Polygon
from shapely.geometry import box as rectangle

from acquisition import SettingError
from sonar_gym import SonarObservation, SonarVectorObservation
from sonar_gym.sensing import paths
from sonar_gym.sensing.mounts import Mount, in_world, mount_arrays
from sonar_gym.sensing.records import CROSSTALK
from sonar_gym.sensing.scene import Hits, box_faces
from sonar_gym.wrappers.highway import ROAD_LAYOUT, boxes_of, pose_of, solid_things

highway_env = pytest.importorskip("highway_env")
AHEAD = [Mount("front", 2.5, 0.0, 0.0), Mount("left", 0.0, 1.0, 90.0), Mount("right", 0.0, -1.0, -90.0)]


ROW = np.zeros(1, dtype=np.int64)


def parking(sonar="ideal", **settings):
    return SonarObservation(gymnasium.make("parking-v0"), sonar, **settings)


def cast(env):
    """Return the conditions of pings on the current road, (s,) each; an ideal sonar has one path per ping."""
    found = env.source.paths(ROW, None, {}, env.sonar.rngs)
    assert np.all(found.counts == 1)
    path = found.paths[0, :, 0].T
    return Hits(*path[:4], path[paths.OBSTACLE] >= 0.0, path[paths.OBSTACLE], path[paths.X :].T)


def bodies_of(things):
    return [Polygon(faces[:, :2]) for faces in box_faces(boxes_of(things)).reshape(-1, 4, 4)]


def put(env, x, y, heading):
    """Place the car, in the frame of highway-env."""
    vehicle = env.unwrapped.vehicle
    vehicle.position, vehicle.heading = np.array([x, y], dtype=float), heading


def test_wall_ahead_is_detected_although_its_centre_is_far():
    env = parking(sonar_layout=AHEAD)
    env.reset(seed=0)
    put(env, 20.0, -16.0, -np.pi / 2)  # nose to the upper wall, whose face lies at y = -20.5 and centre 20 m away
    hits = cast(env)
    assert hits.distance[0] == pytest.approx(20.5 - 16.0 - 2.5)
    assert hits.incidence[0] == pytest.approx(0.0, abs=1e-9)
    put(env, 0.0, 0.0, 0.0)
    assert not cast(env).in_cone.any()


def test_wall_on_the_left_is_detected_by_the_left_sonar():
    env = parking(sonar_layout=AHEAD)
    env.reset(seed=0)
    put(env, 0.0, -17.0, 0.0)  # driving right along the upper wall: the wall is on the left
    hits = cast(env)
    assert list(hits.in_cone) == [False, True, False]
    assert hits.distance[1] == pytest.approx(20.5 - 17.0 - 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_cones_agree_with_shapely_on_a_crowded_road(seed):
    env = SonarObservation(gymnasium.make("highway-v0", config={"vehicles_density": 3}), max_range=30.0)
    env.reset(seed=seed)
    base = env.unwrapped
    hits, (local, half) = cast(env), mount_arrays(ROAD_LAYOUT)
    poses = in_world(local, pose_of(base.vehicle))
    bodies = bodies_of(solid_things(base.road, base.vehicle))
    for i, (pose, opening) in enumerate(zip(poses, half, strict=True)):
        angles = np.linspace(pose[2] - opening, pose[2] + opening, 400)
        arc = np.column_stack([pose[0] + 30.0 * np.cos(angles), pose[1] + 30.0 * np.sin(angles)])
        inside = [body.intersection(Polygon([pose[:2], *arc])) for body in bodies]
        near = [Point(pose[:2]).distance(part) for part in inside if not part.is_empty]
        assert hits.in_cone[i] == bool(near)
        if near:
            assert hits.distance[i] == pytest.approx(min(near), abs=1e-3)


def test_boxes_have_the_dimensions_of_the_walls():
    env = parking()
    env.reset(seed=0)
    walls = solid_things(env.unwrapped.road, env.unwrapped.vehicle)
    assert sorted(max(wall.LENGTH, wall.WIDTH) for wall in walls) == [42, 42, 70, 70]  # the landmark is not solid
    upper = bodies_of(walls)[0]
    assert upper.symmetric_difference(rectangle(-35.0, 20.5, 35.0, 21.5)).area == pytest.approx(0.0, abs=1e-9)


LIDAR = {"observation": {"type": "LidarObservation", "cells": 16}}
GRID = {"observation": {"type": "OccupancyGrid"}}
FEW = {"vehicles_count": 8}
CASES = {
    "goal": ("parking-v0", {}, {"achieved_goal", "desired_goal", "observation"}),
    "own row": ("highway-v0", FEW, {"base"}),
    "lidar": ("highway-v0", {**FEW, **LIDAR}, set()),
    "lidar in the car park": ("parking-v0", LIDAR, set()),
    "grid": ("highway-v0", {**FEW, **GRID}, set()),
    "exit": ("exit-v0", FEW, {"base"}),
    "merge": ("merge-v0", {}, {"base"}),
    "crossing": ("intersection-v0", {}, {"base"}),
    "roundabout": ("roundabout-v0", {}, {"base"}),
    "attributes": ("lane-keeping-v0", {}, {"state", "derivative", "reference_state"}),
}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # highway-env's own
@pytest.mark.parametrize(("name", "config", "retained"), CASES.values(), ids=CASES)
def test_observation_of_the_own_vehicle_is_retained_and_of_others_is_replaced(name, config, retained):
    env = SonarObservation(gymnasium.make(name, config=config), "gaussian")
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    for _ in range(2):
        assert set(observation) == set(env.observation_space.spaces) == retained | {"ranges", "credence", "echo", "age"}
        for part in ("ranges", "credence", "echo", "age"):
            assert observation[part] in env.observation_space[part]
        observation, _, terminated, _, info = env.step(env.action_space.sample())
        assert np.all(observation["echo"][~info["sonar"]["in_cone"]] == 0.0)
        if terminated:
            break


def test_first_row_of_kinematics_is_the_own_vehicle():
    env, bare = (gymnasium.make("highway-v0", config=FEW) for _ in range(2))
    observation, _ = SonarObservation(env).reset(seed=4)
    assert np.array_equal(observation["base"], bare.reset(seed=4)[0][0])


def test_keep_all_and_keep_nothing():
    env = gymnasium.make("highway-v0", config=FEW)
    assert SonarObservation(env, keep="all").reset(seed=0)[0]["base"].shape == (5, 5)
    assert set(SonarObservation(env, keep="nothing").reset(seed=0)[0]) == {"ranges", "credence", "echo", "age"}
    with pytest.raises(SettingError, match="keep: expected one of own, all, nothing, got 'some'"):
        SonarObservation(env, keep="some")


def test_metres_per_unit_scales_the_road():
    """1 m of road is 0.1 m of the sonar: ten times as far in the world, the same reading."""
    full, scaled = parking(sonar_layout=AHEAD), parking(sonar_layout=AHEAD, metres_per_unit=0.1, max_range=3.0)
    for env in (full, scaled):
        env.reset(seed=0)
    put(scaled, 0.0, 0.0, -np.pi / 2)
    assert cast(scaled).distance[0] == pytest.approx(0.1 * (20.5 - 2.5))
    put(full, 0.0, 0.0, -np.pi / 2)
    assert not cast(full).in_cone.any()


def test_time_step_is_that_of_the_policy():
    env = parking(sonar_layout=AHEAD)
    env.reset(seed=0)
    assert env.source.step_s == pytest.approx(0.2)  # 5 Hz
    slow = parking(sonar_layout=[{**vars(mount), "period_s": 0.5, "latency_s": 0.0} for mount in AHEAD])
    slow.reset(seed=0)
    age = [slow.step(np.zeros(2))[0]["age"][0] for _ in range(5)]
    assert age == pytest.approx([0.2, 0.4, 0.1, 0.3, 0.0], abs=1e-6)


def test_reflectance_is_constant_in_an_episode_and_drawn_again_in_the_next():
    env = parking(sonar_layout=AHEAD)
    seen = []
    for _ in range(2):
        env.reset(seed=0 if not seen else None)
        put(env, 20.0, -16.0, -np.pi / 2)
        seen.append([cast(env).reflectance[0] for _ in range(2)])
    assert seen[0][0] == seen[0][1] != seen[1][0] == seen[1][1]


def test_environments_of_a_vector_are_wrapped_one_by_one():
    envs = gymnasium.make_vec("parking-v0", 2, vectorization_mode="sync", wrappers=[SonarObservation])
    observation, _ = envs.reset(seed=7)
    alone, _ = parking().reset(seed=8)
    assert observation["ranges"].shape == (2, 8)
    assert np.array_equal(observation["ranges"][1], alone["ranges"])
    with pytest.raises(SettingError, match="does not support highway-env: wrap each environment alone"):
        SonarVectorObservation(gymnasium.make_vec("parking-v0", 2, vectorization_mode="sync"))


def test_environment_is_the_same_with_and_without_the_wrapper():
    bare, wrapped = gymnasium.make("parking-v0"), parking(sonar="gaussian")
    for seed in (1, None):
        first, second = bare.reset(seed=seed)[0], wrapped.reset(seed=seed)[0]
        assert np.array_equal(first["observation"], second["observation"])
        assert np.array_equal(first["desired_goal"], second["desired_goal"])


def test_same_seed_gives_same_readings():
    first, second = (parking(sonar="gaussian").reset(seed=9)[0]["ranges"] for _ in range(2))
    assert np.array_equal(first, second)


def test_spec_survives_json():
    env = parking(sonar="gaussian", sonar_layout=AHEAD, max_range=4.0)
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.get_wrapper_attr("source").mounts == tuple(AHEAD)
    assert again.observation_space["ranges"].shape == (3,)


def test_several_vehicles_and_zero_range_raise():
    with pytest.raises(SettingError, match=r"max_range: expected a number from 0.01 to 1000 m, got 0 m"):
        parking(max_range=0.0)
    many = {
        "controlled_vehicles": 2,
        "action": {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}},
        "observation": {"type": "MultiAgentObservation", "observation_config": {"type": "Kinematics"}},
    }
    with pytest.raises(SettingError, match="supports one vehicle"):
        SonarObservation(gymnasium.make("highway-v0", config=many))


def crosstalk_share(**settings):
    """Return the share of readings that come from another sonar's burst, beside vehicles on the road."""
    road = gymnasium.make("highway-v0", config={**FEW, "vehicles_density": 2})
    env = SonarObservation(road, "srf08-mlp", metres_per_unit=0.1, max_range=3.0, **settings)
    causes = []
    for seed in range(3):
        env.reset(seed=seed)
        for _ in range(6):
            env.step(1)
            causes.append(env.sensing.pings.cause.copy())
    return np.mean(np.array(causes) == CROSSTALK)


def test_sonars_on_a_road_hear_each_other_unless_turned_off():
    assert crosstalk_share() > 0.0
    assert crosstalk_share(crosstalk=False) == 0.0
