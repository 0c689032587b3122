"""The reflectors in a cone: visibility against shapely, and which of them a law is given."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon

from acquisition import Ping
from noise import GaussianModel, IdealModel, load_model
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.sensing import paths
from sonar_gym.sensing.detection import detection_table, is_own_echo
from sonar_gym.sensing.scene import Box, Scene, WallSegment

HALF = math.radians(27.5)
EVERYTHING = np.full((2, 2, 2, 2), 0.5)  # a table that hides nothing and drops nothing


def cast(obstacles, table=EVERYTHING, pose=(0.0, 0.0, 0.0), limit=MAX_RANGE):
    scene, out = Scene(obstacles), np.zeros((paths.MAX_PATHS, paths.N_PATH))
    count = paths.cast_paths(*pose, HALF, scene.segments, scene.surface, scene.owner, limit, table, out)
    return out[:count]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0.4, 2.5), st.floats(-1.0, 1.0), st.floats(0.0, 3.1)), min_size=1, max_size=3))
def test_points_are_the_nearest_that_can_be_seen(places):
    boxes = [Box(x, y, 0.3, 0.2, heading) for x, y, heading in places]
    bodies = [Polygon(box.corners) for box in boxes]
    if any(a.intersects(b) for i, a in enumerate(bodies) for b in bodies[:i]) or any(
        body.distance(Point(0.0, 0.0)) < 0.05 for body in bodies
    ):
        return
    found, scene = cast(boxes), Scene(boxes)
    rays = np.linspace(-HALF + 1e-6, HALF - 1e-6, 4001)
    seen = visible_by_rays(scene.segments, rays)
    for path in found[found[:, paths.OBSTACLE] >= 0]:
        face = LineString(scene.segments[int(path[paths.FACE])].reshape(2, 2))
        assert Point(path[paths.X], path[paths.Y]).distance(face) < 1e-7
        assert abs(path[paths.BEARING]) <= HALF + 1e-9
    if len(found) < paths.MAX_PATHS:
        nearest = {int(path[paths.FACE]): path[paths.DISTANCE] for path in found}
        for face, distance in seen.items():  # of two faces that share a corner, one has the point
            # rays are coarse on a face seen at a grazing angle, whose nearest point is up to its length nearer
            others = [d for d in nearest.values() if -1e-3 <= distance - d <= 0.3]
            assert distance > MAX_RANGE - 0.01 or others, (face, distance)


def visible_by_rays(segments, rays):
    """Return the distance of the nearest point of each face that a fan of rays meets first, by the face's number."""
    direction = np.stack([np.cos(rays), np.sin(rays)], axis=1)
    a, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    cross = direction[:, None, 0] * along[None, :, 1] - direction[:, None, 1] * along[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (a[None, :, 0] * along[None, :, 1] - a[None, :, 1] * along[None, :, 0]) / cross
        u = (a[None, :, 0] * direction[:, None, 1] - a[None, :, 1] * direction[:, None, 0]) / cross
    t = np.where((u >= 0) & (u <= 1) & (t > 0), t, np.inf)
    first = np.argmin(t, axis=1)
    out = {}
    for ray in np.flatnonzero(np.isfinite(t.min(axis=1))):
        out[first[ray]] = min(out.get(first[ray], np.inf), t[ray].min())
    return out


def test_a_box_hides_the_wall_behind_it_where_it_stands():
    # the box covers bearings up to 0.1/0.9 rad; the nearest visible point of the wall is beside it
    wall, box = WallSegment(2.0, -5.0, 2.0, 5.0), Box(1.0, 0.0, 0.2, 0.2)
    found = {int(path[paths.OBSTACLE]): path for path in cast([wall, box])}
    assert found[1][paths.DISTANCE] == pytest.approx(0.9)
    assert abs(found[0][paths.Y]) == pytest.approx(2.0 * 0.1 / 0.9)
    wide = {int(path[paths.OBSTACLE]) for path in cast([wall, Box(1.0, 0.0, 0.2, 2.0)])}
    assert wide == {1}


def test_two_faces_of_a_corner_are_one_path():
    found = cast([Box(1.0, 0.0, 0.4, 0.4, math.radians(45.0))])
    assert len(found) == 1
    assert found[0, paths.DISTANCE] == pytest.approx(1.0 - 0.2 * math.sqrt(2.0))


def test_an_empty_cone_has_one_path_without_an_obstacle():
    found = cast([WallSegment(-1.0, -1.0, -1.0, 1.0)])
    assert found[:, paths.OBSTACLE].tolist() == [-1.0]
    assert found[0, paths.DISTANCE] == MAX_RANGE


def test_an_ideal_sonar_has_the_nearest_path_only():
    far, near = WallSegment(2.0, -0.2, 2.0, 5.0), Box(1.0, -0.3, 0.2, 0.2)
    found = cast([far, near], detection_table(IdealModel(), MAX_RANGE))
    assert found[:, paths.OBSTACLE].tolist() == [1.0]


def test_the_path_detected_most_often_is_last():
    wall, kerb = WallSegment(2.0, -0.65, 2.0, 5.0, 0.9), WallSegment(-1.0, -0.65, 2.0, -0.65, 0.4)
    found = cast([wall, kerb], detection_table(load_model("srf08-mlp"), MAX_RANGE))
    assert found[-1, paths.OBSTACLE] == 0.0


def wall_with_kerbs(sonar, episodes=600):
    """Return the share of readings of the wall at 2 m, with kerbs beside the lane, and by the law alone."""
    nose = [{"name": "nose", "x": 0.36, "y": 0.0, "heading_deg": 0.0}]
    env = SonarParkingEnv(sonar=sonar, sonar_layout=nose, credence_driver=None)
    boxes = [{"begin": 0.6, "length": 0.3}, {"begin": 2.2, "length": 0.3}]
    # the wall stands 1 m behind the last box, at x = 3.5 m; its reflectance is that of the kerbs
    start = {"boxes": boxes, "start": [3.5 - 2.0 - 0.36, 0.38, 0.0], "street": {"recess": (0.0, 0.0)}}
    heard = 0
    for seed in range(episodes):
        observation, info = env.reset(seed=seed, options=start)
        reading = MAX_RANGE * float(observation["ranges"][0])
        heard += abs(reading - 2.0) < 0.1
        assert info["distance"][0] > 0.0
    law = load_model(sonar).law(Ping.of(2.0, 0.0, 0.0, 0.4, run=[0]))
    alone = law.arrival(np.array([2.1])) - law.arrival(np.array([1.9]))
    return heard / episodes, float(alone[0])


@pytest.mark.parametrize(
    "sonar", ["srf08-mlp", *(pytest.param(name, marks=pytest.mark.slow) for name in ("srf08-lstm", "srf08-hybrid"))]
)
def test_a_wall_with_kerbs_beside_the_lane_is_heard_as_by_the_law_alone(sonar):
    heard, alone = wall_with_kerbs(sonar)
    standard_error = math.sqrt(alone * (1.0 - alone) / 600)
    assert heard >= 0.95 * alone - 2.0 * standard_error


def test_an_own_echo_is_late_by_no_more_than_the_rise_of_a_burst():
    reading = GaussianModel(sigma=0.0).law(Ping.of([1.0, 1.079, 1.1])).sample(np.random.default_rng(0))
    assert is_own_echo(np.ones(3), reading).tolist() == [True, True, False]
