"""Cones and contact against shapely; kinematics against hand calculations and a numerical solution."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from shapely import LineString, Point, Polygon
from shapely.affinity import rotate, translate

from sonar_gym.sensing import kernels
from sonar_gym.street.vehicle import Car, CarSettings

LIMIT = 3.0
LENGTH = st.floats(-2.0, 2.0)
ANGLE = st.floats(-math.pi, math.pi)
SEGMENT = st.tuples(LENGTH, LENGTH, LENGTH, LENGTH).filter(lambda s: math.dist(s[:2], s[2:]) > 0.05)
NO_WALLS = np.empty((0, 4))


def drive(car, steering, speed, segments, dt, parts=5):
    """Drive for dt s in equal parts; return the car and the index of the segment touched, or -1."""
    s, state, hit = car.settings, car.state.copy(), -1
    for _ in range(parts):
        commands = steering * s.max_steering, speed * s.max_speed
        hit, _ = kernels.drive_part(state, *commands, s.dynamics, s.body, segments, dt / parts)
        if hit >= 0:
            state[3] = 0.0
            break
    return Car(s, state), hit


def nearest(pose, half, radius, segments):
    """Return the distance of the nearest point in a sector, computed by shapely; infinity if there is none."""
    angles = np.linspace(pose[2] - half, pose[2] + half, 501)
    arc = np.column_stack([pose[0] + radius * np.cos(angles), pose[1] + radius * np.sin(angles)])
    cone = Polygon([pose[:2], *arc])
    pieces = [LineString([s[:2], s[2:]]).intersection(cone) for s in segments]
    return min((Point(pose[:2]).distance(piece) for piece in pieces if not piece.is_empty), default=math.inf)


@settings(max_examples=60, deadline=None)
@given(st.tuples(LENGTH, LENGTH, ANGLE), st.floats(0.05, 1.5), st.lists(SEGMENT, min_size=1, max_size=5))
def test_nearest_point_in_a_cone_agrees_with_shapely(pose, half, segments):
    assume(all(Point(pose[:2]).distance(LineString([s[:2], s[2:]])) > 1e-6 for s in segments))
    distance, bearing, incidence, index, point = kernels.cast_cones(
        np.array([pose]), np.array([half]), np.array(segments), LIMIT
    )
    # points on the edge are in or out by rounding: compare with a slightly wider and a slightly narrower cone
    found = distance[0] if index[0] >= 0 else math.inf
    assert nearest(pose, half + 1e-5, LIMIT + 0.01, segments) <= found + 1e-7
    assert found <= nearest(pose, half - 1e-5, LIMIT - 0.01, segments) + 1e-7
    if index[0] >= 0:
        assert abs(bearing[0]) <= half + 1e-9
        assert 0.0 <= incidence[0] <= math.pi / 2
        assert math.dist(point[0], pose[:2]) == pytest.approx(distance[0], abs=1e-9)
        assert Point(point[0]).distance(LineString([segments[index[0]][:2], segments[index[0]][2:]])) < 1e-9


def test_wall_straight_ahead_has_normal_incidence():
    wall = np.array([[2.0, -1.0, 2.0, 1.0]])
    distance, bearing, incidence, index, point = kernels.cast_cones(np.zeros((1, 3)), np.array([0.48]), wall, LIMIT)
    assert (distance[0], bearing[0], incidence[0], index[0]) == (2.0, 0.0, 0.0, 0)
    assert list(point[0]) == [2.0, 0.0]


def test_wall_with_its_foot_outside_the_cone_is_nearest_at_the_edge_of_the_cone():
    # axis 60 deg off the normal of a wall 1 m away, half cone 20 deg: nearest point at 40 deg, 1/cos(40 deg) away
    wall = np.array([[1.0, -50.0, 1.0, 50.0]])
    pose = np.array([[0.0, 0.0, math.radians(60.0)]])
    distance, bearing, incidence, _, _ = kernels.cast_cones(pose, np.array([math.radians(20.0)]), wall, LIMIT)
    assert distance[0] == pytest.approx(1.0 / math.cos(math.radians(40.0)))
    assert math.degrees(bearing[0]) == pytest.approx(-20.0)
    assert math.degrees(incidence[0]) == pytest.approx(40.0)


def test_empty_cone_reports_nothing_at_the_limit():
    distance, _, _, index, _ = kernels.cast_cones(
        np.zeros((1, 3)), np.array([0.3]), np.array([[-1.0, -1, -1, 1]]), LIMIT
    )
    assert (distance[0], index[0]) == (LIMIT, -1)


def test_corner_has_the_incidence_of_the_face_closer_to_normal():
    # both faces of the corner (1, 0) are in the cone; the ray along x is normal to one and parallel to the other
    faces = np.array([[2.0, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 1.0]])
    for order in (faces, faces[::-1].copy()):
        assert kernels.cast_cones(np.zeros((1, 3)), np.array([0.3]), order, LIMIT)[2][0] == 0.0


@settings(max_examples=60, deadline=None)
@given(st.tuples(LENGTH, LENGTH, ANGLE), SEGMENT)
def test_contact_agrees_with_shapely(pose, segment):
    body = CarSettings().body
    rectangle = Polygon([(body[0], body[1]), (body[2], body[1]), (body[2], body[3]), (body[0], body[3])])
    placed = translate(rotate(rectangle, pose[2], origin=(0, 0), use_radians=True), pose[0], pose[1])
    line = LineString([segment[:2], segment[2:]])
    hit = kernels.touches(np.array(pose), body, np.array([segment])) == 0
    if placed.exterior.distance(line) > 1e-9 or placed.buffer(-1e-9).intersects(line):
        assert hit == placed.intersects(line)


def test_quarter_circle_by_hand():
    # radius 2 m, a quarter turn to the left: from the origin to (2, 2), with a heading of pi/2
    pose = kernels.roll(np.zeros(3), math.pi, 0.5)
    assert pose == pytest.approx([2.0, 2.0, math.pi / 2])


def test_straight_line_is_the_limit_of_wide_arcs():
    assert kernels.roll(np.array([1.0, 2.0, 0.3]), 0.7, 0.0) == pytest.approx(
        [1.0 + 0.7 * math.cos(0.3), 2.0 + 0.7 * math.sin(0.3), 0.3]
    )
    assert kernels.roll(np.zeros(3), 0.7, 1e-10) == pytest.approx([0.7, 0.0, 0.0], abs=1e-9)


@settings(deadline=None)  # the first call compiles
@given(st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))
def test_moving_back_undoes_moving_forth(travel, curvature):
    start = np.array([0.3, -0.2, 0.5])
    assert kernels.roll(kernels.roll(start, travel, curvature), -travel, curvature) == pytest.approx(start, abs=1e-9)


def test_maximum_steering_gives_the_turning_radius():
    settings_ = CarSettings(steering_lag=0.0, steering_rate=1e9, acceleration=1e9, speed_lag=0.0)
    assert settings_.turning_radius == pytest.approx(0.26 / math.tan(math.radians(30.0)))
    car = Car.at(settings_, 0.0, 0.0, 0.0)
    for _ in range(20):
        car, _ = drive(car, 1.0, 1.0, NO_WALLS, 0.1)
        assert math.dist(car.pose[:2], (0.0, settings_.turning_radius)) == pytest.approx(settings_.turning_radius)


def test_car_follows_the_bicycle_equations():
    s = CarSettings()

    def slope(_, state):
        _, _, heading, speed, steering = state
        turn = speed * math.tan(steering) / s.wheelbase
        faster = np.clip((0.4 - speed) / s.speed_lag, -s.acceleration, s.acceleration)
        wheel = np.clip((0.3 - steering) / s.steering_lag, -s.steering_rate, s.steering_rate)
        return [speed * math.cos(heading), speed * math.sin(heading), turn, faster, wheel]

    exact = solve_ivp(slope, (0.0, 2.0), [0.0] * 5, rtol=1e-9, atol=1e-9, max_step=0.005).y[:, -1]
    car, _ = drive(Car.at(s, 0.0, 0.0, 0.0), 0.3 / s.max_steering, 0.4 / s.max_speed, NO_WALLS, 2.0, parts=2000)
    assert car.state == pytest.approx(exact, abs=2e-3)


def test_servo_and_motor_respect_their_limits():
    s = CarSettings()
    car, _ = drive(Car.at(s, 0.0, 0.0, 0.0), 1.0, 1.0, NO_WALLS, 0.1)
    assert 0.0 < car.speed <= s.acceleration * 0.1 + 1e-12
    assert 0.0 < car.steering <= s.steering_rate * 0.1 + 1e-12
    for _ in range(50):
        car, _ = drive(car, 1.0, 1.0, NO_WALLS, 0.1)
    assert (car.speed, car.steering) == (pytest.approx(s.max_speed), pytest.approx(s.max_steering))


def test_car_stops_at_a_wall():
    car, hit = Car.at(CarSettings(), 0.0, 0.0, 0.0), -1
    wall = np.array([[0.6, -1.0, 0.6, 1.0]])
    while hit < 0:
        car, hit = drive(car, 0.0, 1.0, wall, 0.1)
    assert car.speed == 0.0
    front = max(kernels.out_of_frame(car.settings.body[2], y, car.pose)[0] for y in car.settings.body[1::2])
    assert front == pytest.approx(0.6, abs=CarSettings().max_speed * 0.02)
