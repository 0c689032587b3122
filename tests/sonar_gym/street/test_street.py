"""Streets, scenes and layouts: random quantities stay within their limits, invalid settings raise errors."""

import numpy as np
import pytest

from acquisition import SettingError
from sonar_gym.sensing.kernels import touches
from sonar_gym.sensing.mounts import LAYOUTS, Mount, in_world, layout, mount_arrays
from sonar_gym.sensing.scene import EMPTY_M, Box, Scene, WallSegment
from sonar_gym.street.street import START_BEFORE, StreetSettings, draw_street
from sonar_gym.street.vehicle import CarSettings
from tests.sonar_gym.parking.reference import reference_path

STREETS = [draw_street(StreetSettings(), np.random.default_rng(seed)) for seed in range(200)]


def spaces(street):
    ends = np.array([(b.x - 0.5 * b.length, b.x + 0.5 * b.length) for b in street.boxes])
    return ends[1:, 0] - ends[:-1, 1]


def test_each_street_has_exactly_one_space_that_is_long_enough():
    for street in STREETS:
        lengths = spaces(street)
        wide = lengths >= 0.85
        assert wide.sum() == 1
        assert np.all(lengths[~wide] <= 0.45 + 1e-9)
        assert street.gap[1] - street.gap[0] == pytest.approx(lengths[wide][0])


def test_all_random_quantities_vary_between_streets():
    assert {len(street.boxes) for street in STREETS} == {2, 3, 4}
    reflectance = np.array([box.reflectance for street in STREETS for box in street.boxes])
    assert reflectance.min() < 0.15
    assert reflectance.max() > 0.85
    assert np.ptp([street.start[1] for street in STREETS]) > 0.05


def test_starts_lie_between_the_beginning_of_the_street_and_the_gap():
    share = np.array([street.start[0] / (street.gap[0] - START_BEFORE) for street in STREETS])
    assert share.min() >= 0.0
    assert share.max() <= 1.0
    assert np.histogram(share, 4, (0.0, 1.0))[0].min() > 30  # of 200, uniform
    whole = draw_street(StreetSettings(start=(0.0, 0.0)), np.random.default_rng(0))
    assert whole.start[0] == 0.0
    assert np.array_equal(whole.strip, STREETS[0].strip)


def test_a_start_beyond_the_gap_raises_an_error():
    with pytest.raises(SettingError, match=r"StreetSettings.start: expected a number from 0 to 1, got"):
        StreetSettings(start=(0, 1.5))


def test_reference_path_is_feasible_and_free_of_contact():
    car = CarSettings()
    for street in STREETS[:100]:
        path = reference_path(street, car)
        turn, moved = np.abs(np.diff(path[:, 2])), np.hypot(*np.diff(path[:, :2], axis=0).T)
        assert np.all(turn <= moved / car.turning_radius + 1e-9)
        assert np.all(np.diff(path[:, 3]) <= 0)
        assert path[-1, 3] == 0.0
        on_street = path[path[:, 0] > street.start[0]]
        segments = street.scene.segments
        assert all(touches(pose, car.body, segments) == -1 for pose in on_street[:, :3].copy())


def test_same_generator_state_gives_same_street():
    a, b = (draw_street(StreetSettings(), np.random.default_rng(7)) for _ in range(2))
    assert a.boxes == b.boxes
    assert np.array_equal(a.scene.segments, b.scene.segments)


def test_gap_not_longer_than_a_decoy_raises_an_error():
    with pytest.raises(SettingError, match=r"gap must exceed decoy: shortest gap 0.4 m, longest decoy 0.45 m"):
        StreetSettings(gap=(0.4, 1.0))


def test_pair_out_of_order_raises_an_error():
    with pytest.raises(SettingError, match=r"StreetSettings\.box must be two numbers"):
        StreetSettings(box=(0.7, 0.3))


def test_box_faces_are_closed_and_have_its_reflectance():
    box = Box(1.0, 2.0, 0.4, 0.2, 0.3, reflectance=0.7)
    assert np.allclose(box.faces[:, 2:], np.roll(box.faces[:, :2], -1, axis=0))
    assert np.allclose(box.corners.mean(axis=0), [1.0, 2.0])
    hits = Scene([WallSegment(-1, -1, -1, 1), box]).cast(np.array([[1.0, 0.0, np.pi / 2]]), np.array([0.3]), 3.0)
    assert (hits.reflectance[0], hits.obstacle[0]) == (0.7, 1)


@pytest.mark.parametrize("make", [lambda r: WallSegment(0, 0, 1, 0, r), lambda r: Box(0, 0, 1, 1, 0, r)])
def test_reflectance_outside_its_limits_raises_an_error(make):
    with pytest.raises(SettingError, match=r"reflectance: expected a number from 0 to 1, got 1.5"):
        make(1.5)


def test_box_without_extent_raises_an_error():
    with pytest.raises(SettingError, match=r"Box\.length: expected a number above 0"):
        Box(0, 0, 0.0, 1.0)


def test_cones_on_an_empty_scene_are_empty():
    hits = Scene([]).cast(np.zeros((2, 3)), np.array([0.3, 0.4]), 3.0)
    assert not hits.in_cone.any()
    ping = hits.ping(1.5)
    assert np.all(ping.distance == EMPTY_M)
    assert np.all(ping.time == 1.5)


def test_mounts_rotate_with_the_car():
    poses, half = mount_arrays([Mount("side", 0.2, -0.1, -90.0, 40.0)])
    world = in_world(poses, np.array([1.0, 2.0, np.pi / 2]))
    assert world[0] == pytest.approx([1.1, 2.2, 0.0])
    assert np.degrees(half[0]) == pytest.approx(20.0)


def test_layouts_by_name_by_mounts_and_by_mappings():
    assert len(layout("eight")) == 8
    assert layout([{"name": "nose", "x": 0.3, "y": 0.0, "heading_deg": 0.0}])[0] == Mount("nose", 0.3, 0.0, 0.0)
    assert layout(LAYOUTS["four"]) == LAYOUTS["four"]
    with pytest.raises(
        SettingError,
        match="sonar_layout: expected one of eight, eight in turn, eight without latency, four, got 'five'",
    ):
        layout("five")
    with pytest.raises(SettingError, match="sonar_layout has 0 mounts"):
        layout([])
    with pytest.raises(
        SettingError, match=r"cone_deg of 'x': expected a number above 0 and below 180 deg, got 180 deg"
    ):
        Mount("x", 0, 0, 0, 180.0)


@pytest.mark.parametrize("field", ["length", "wheelbase", "max_speed"])
def test_car_measures_are_checked(field):
    with pytest.raises(SettingError, match=f"CarSettings.{field}: expected a number above 0 "):
        CarSettings(**{field: 0.0})
