"""Streets, scenes and layouts: random quantities stay within their limits, invalid settings raise errors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import SettingError
from sonar_gym.sensing.kernels import touches
from sonar_gym.sensing.mounts import LAYOUTS, Mount, in_world, layout, mount_arrays
from sonar_gym.sensing.scene import Box, Scene, WallSegment
from sonar_gym.street.street import MAX_TURN_DEG, START_BEFORE, StreetSettings, draw_street, start_of, street_of
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


def pairs(low, high):
    return st.tuples(st.floats(low, high), st.floats(low, high)).map(sorted)


@settings(max_examples=200)
@given(pairs(0.0, 0.8), pairs(0.0, 0.4), pairs(0.0, 20.0), st.integers(0, 9))
def test_every_box_of_valid_settings_has_an_extent(box, recess, turn_deg, seed):
    try:
        valid = StreetSettings(box=box, recess=recess, turn_deg=turn_deg)
    except SettingError:
        return
    assert draw_street(valid, np.random.default_rng(seed)).boxes  # a `Box` has positive sides


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"recess": (0.0, 0.35)}, r"recess: a box 0.7 m .* wider than 0 m, but depth - recess is 0 m: make depth"),
        ({"recess": (0.4, 0.5)}, r"recess: a box 0.7 m .* wider than 0 m, but depth - recess is -0.15 m: make depth"),
        ({"turn_deg": (0, 20), "box": (0.3, 1.0)}, r"recess: .* turned by 20 deg must be wider than 0.36397 m, but"),
        ({"box": (0, 0)}, r"box: a box 0.35 m wide and turned by 0 deg must be longer than 0 m, got 0 m: make box"),
        ({"turn_deg": (20, 20), "box": (0.05, 0.1)}, r"box: a box 0.35 m .* longer than 0.12739 m, got 0.05 m: make"),
    ],
)
def test_boxes_without_an_extent_raise_an_error(given, message):
    with pytest.raises(SettingError, match=message):
        StreetSettings(**given)


def test_a_given_box_is_turned_within_the_limits_of_a_street():
    def street(turn_deg):
        return street_of(StreetSettings(), [{"begin": x, "length": 0.5, "turn_deg": turn_deg} for x in (0.6, 2.0)])

    for turn_deg in (-MAX_TURN_DEG, MAX_TURN_DEG):
        assert np.degrees(street(turn_deg).boxes[0].heading) == pytest.approx(turn_deg)
    with pytest.raises(SettingError, match="boxes: turn_deg: expected a number from -20 to 20 deg, got 45 deg"):
        street(45)


@given(st.floats(-1e3, 1e3))
def test_headings_of_a_start_that_differ_by_whole_turns_are_one(heading):
    start = start_of([1.0, -0.1, heading])
    assert np.abs(start[2]) <= np.pi
    assert [np.cos(start[2]), np.sin(start[2])] == pytest.approx([np.cos(heading), np.sin(heading)], abs=1e-9)
    assert start_of(start).tolist() == start.tolist()


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
    assert np.all(hits.distance == 3.0)
    assert np.all(hits.reflectance == 0.0)
    assert np.all(hits.obstacle == -1)


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
