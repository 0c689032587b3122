"""Posts, walls and their images, the floor: levels and path lengths against independent computations."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition.bench import MIRROR, Plate, Post, Room, Scatterer, Setup, Unit
from acquisition.bench.acoustics.arrivals import BOUNCE, CEILING, CLUTTER, FACE, FLOOR, POST, SIDES, WALL
from acquisition.bench.acoustics.geometry import PathGeometry, Poses
from acquisition.bench.acoustics.room import arrivals
from acquisition.bench.laboratory.air import Air, Gradient, sound_speed

SPEED = float(sound_speed(19.0, 50.0))
WAVELENGTH = SPEED / 40e3
BARE = replace(Unit.nominal(), radius=1e-6, leak_db=-300.0, sensitivity_db=60.0)  # omnidirectional
EMPTY = Setup.static()


def geometry(distance, incidence_deg=0.0, bearing_deg=0.0, setup=EMPTY, unit=BARE, reflectance=1.0, shape=MIRROR):
    one = [np.array([float(x)]) for x in (distance, np.deg2rad(bearing_deg), np.deg2rad(incidence_deg), 0.0, 0.0)]
    air = Air(np.array([19.0]), np.array([SPEED]), np.array([0.0]))
    return PathGeometry(unit, replace(setup, reflector=shape), Poses(*one), np.array([reflectance]), air)


def room(**surfaces):
    return replace(EMPTY, room=Room(**{"height": None, "ceiling": None, "wall": None, **surfaces}))


def lengths(geometry_, group):
    return np.sort(arrivals(geometry_).only(group).length)


def wall_db(paths):
    """Level of each path relative to a wall at the same distance, dB."""
    return 20.0 * np.log10(np.abs(paths.amplitude) * 2.0 * paths.length)


def test_positions_of_room_echoes():
    setup = replace(room(height=1.5, ceiling=3.0, wall=9.0), post=Post(radius=0.015, behind=0.3))
    found = arrivals(geometry(4.0, setup=setup, unit=replace(BARE, radius=6.55e-3)))
    assert found.only(POST).length == pytest.approx([4.3 - 0.015, np.hypot(4.3, 1.5)])
    floor = found.only(FLOOR).length
    assert np.abs(floor - np.hypot(9.0, 1.5)).min() < 1e-9
    via_floor = floor[floor < 4.75]
    assert via_floor.mean() == pytest.approx((np.sqrt(4.0**2 + 3.0**2) + 4.0) / 2.0, abs=0.01)
    assert found.only(WALL).length == pytest.approx([9.0])
    assert found.only(BOUNCE).length.min() == pytest.approx(8.0)


def test_images_of_first_and_second_order():
    """Walls at their distances, corners at the root of the squares; between two walls once to and fro: their distance.

    A sonar emits nothing straight to the side and down, so a wall there echoes only by way of corners.
    """
    setup = room(height=0.5, ceiling=2.0, wall=3.0, left=1.0, right=2.0)
    silent = geometry(1.0, setup=setup, reflectance=0.0)
    assert lengths(silent, WALL) == pytest.approx(np.sort([3.0, np.hypot(3.0, 1.0), np.hypot(3.0, 2.0)]))
    assert lengths(silent, FLOOR) == pytest.approx([np.hypot(0.5, 3.0)])
    assert lengths(silent, CEILING) == pytest.approx([np.hypot(1.5, 3.0)])
    assert len(lengths(silent, SIDES)) == 0
    corner = arrivals(silent).only(FLOOR)
    assert wall_db(corner) == pytest.approx(20.0 * np.log10(0.9 * 0.9))  # retro-reflecting, two bounces


def test_turned_beam_between_two_walls_has_the_round_trip_echo():
    """A turned sonar receives left and right wall, and the round trip by both, whose half length is their distance."""
    unit = replace(BARE, yaw=np.deg2rad(5.0))
    found = arrivals(geometry(1.0, setup=room(left=1.0, right=2.0), reflectance=0.0, unit=unit)).only(SIDES)
    assert np.sort(found.length) == pytest.approx([1.0])  # of the right wall only what is sent backwards
    spilled = replace(unit, spill=0.1)
    found = arrivals(geometry(1.0, setup=room(left=1.0, right=2.0), reflectance=0.0, unit=spilled)).only(SIDES)
    assert np.sort(found.length) == pytest.approx([1.0, 2.0, 3.0])


def test_reflector_near_a_floor_has_indirect_paths_on_one_and_both_legs():
    """Sensor and plate over a hard floor at height h: detours of d, sqrt(d^2 + (2h)^2) on one leg or on both."""
    setup = room(height=0.2, floor_factor=1.0)
    found = lengths(geometry(2.0, setup=setup, shape=Plate(0.02, 0.02)), FLOOR)
    slant = np.hypot(2.0, 0.4)
    assert found.min() == pytest.approx(0.5 * (2.0 + slant), abs=0.01)
    assert found.max() == pytest.approx(slant, abs=0.01)


def test_small_plate_over_a_mirror_floor_is_four_plates():
    """With a small plate, the waves by the floor on no, one (two senses) and both legs add as 1, 2 and 1."""
    found = arrivals(geometry(3.0, setup=room(height=0.05, floor_factor=1.0), shape=Plate(0.012, 0.012)))

    def field(group):
        paths = found.only(group)
        return (paths.amplitude * np.exp(-4j * np.pi * paths.length / WAVELENGTH)).sum()

    longer = np.hypot(3.0, 0.1) - 3.0
    once, twice = (np.exp(-2j * np.pi * legs * longer / WAVELENGTH) for legs in (1, 2))
    expected = field(FACE) * (2.0 * once + twice)
    assert abs(field(FLOOR) - expected) < 0.03 * abs(expected)


def test_indirect_path_by_a_near_floor_matches_the_mirror_image():
    """A tall plate on a near floor: sensor, floor, plate, sensor is the mirror image's perpendicular, if both exist.

    Its amplitude is then that of a wall at half the path length, in both directions.
    """
    found = arrivals(geometry(1.0, setup=room(height=0.05, floor_factor=1.0), shape=Plate(0.8, 0.8))).only(FLOOR)
    once = found.length < np.inf
    phase = np.exp(-4j * np.pi * found.length / WAVELENGTH)
    half = np.sqrt(1.0 + 0.1**2 / 4)
    assert abs((found.amplitude * phase)[once].sum()) > 0.65 * 2.0 / (2.0 * half)


def test_post_is_shadowed_behind_the_face_only():
    setup = replace(EMPTY, post=Post())
    hidden, beside = geometry(1.0, setup=setup), geometry(1.0, 35.0, 35.0, setup=setup)
    assert abs(arrivals(hidden).only(POST).amplitude[0]) < 0.35 * abs(arrivals(beside).only(POST).amplitude[0])
    place = np.array([np.cos(np.deg2rad(35.0)) + 0.3, np.sin(np.deg2rad(35.0)), 0.0])
    assert hidden.shadow(place[None, None])[0, 0] == pytest.approx(1.0, abs=0.15)


def alone(post, distance=1.0, incidence_deg=0.0):
    """Echo of a post without a reflector."""
    setup = replace(EMPTY, post=post)
    return arrivals(geometry(distance, incidence_deg, setup=setup, reflectance=0.0)).only(POST)


def test_round_post_is_19_db_below_a_wall():
    paths = alone(Post(radius=0.015), 1.015)
    assert paths.length == pytest.approx([1.3])
    assert wall_db(paths) == pytest.approx([-19.0], abs=0.5)


@pytest.mark.parametrize(("distance", "level"), [(1.3, -5.0), (4.3, -11.0)])
@pytest.mark.parametrize("profile", ["flat", "square"])
def test_flat_faced_post_of_40_mm(profile, distance, level):
    depth = 0.02 if profile == "square" else 0.0
    paths = alone(Post(0.02, 0.3, profile), distance - 0.3 + depth)
    front = paths[np.argmax(np.abs(paths.amplitude))]
    assert front.length == pytest.approx(distance)
    assert wall_db(front) == pytest.approx(level, abs=0.7)


def test_lobe_width_of_a_flat_post():
    """First null where the two-way phase over 40 mm is a turn: sin t = wavelength / (2 w), 6.1 degrees; far away."""
    strong, null = (wall_db(alone(Post(0.02, 0.0, "flat"), 20.0, turn))[0] for turn in (0.0, 6.16))
    assert null < strong - 20.0


def test_strip_agrees_with_the_sum_over_facets():
    """Against the sum over an upright strip's facets, near and far, facing and turned: within half a dB."""
    x = (np.arange(400) + 0.5) / 400 * 0.06 - 0.03
    z = (np.arange(8001) - 4000) * 1e-3
    for distance, turn in ((0.8, 0.0), (0.8, 3.0), (2.5, 2.0), (2.5, 9.0)):
        t = np.deg2rad(turn)
        px, py = distance - x * np.sin(-t), x * np.cos(t)
        h = distance * np.cos(t)
        r = np.sqrt(px[:, None] ** 2 + py[:, None] ** 2 + z**2)
        taper = np.cos(0.5 * np.pi * z / 4.0) ** 2  # of the endless strip's far ends
        total = (taper * 1j * h / (WAVELENGTH * r**3) * np.exp(-4j * np.pi * r / WAVELENGTH)).sum() * 1.5e-4 * 1e-3
        paths = alone(Post(0.03, 0.0, "flat"), distance, turn)
        assert np.abs(paths.amplitude[0]) == pytest.approx(abs(total), rel=0.07 if turn < 5.0 else 0.15), (
            distance,
            turn,
        )


def test_clutter_scatters_as_a_sphere():
    thing = Scatterer((2.0, 0.0, 0.0), strength_db=20.0 * np.log10(0.05))
    paths = arrivals(geometry(1.0, setup=room(clutter=(thing,)), reflectance=0.0)).only(CLUTTER)
    assert paths.length == pytest.approx([2.0])
    assert abs(paths.amplitude[0]) == pytest.approx(0.05 / 4.0)


def test_rough_floor_echoes_begin_where_the_beam_meets_it():
    """At 1.5 m over it, the beam's -6 dB edge meets the floor 3.25 m away: clutter is strong from there on."""
    setup = room(height=1.5, floor_scatter_db=-20.0)
    paths = arrivals(geometry(1.0, setup=setup, reflectance=0.0, unit=replace(Unit.nominal(), leak_db=-300.0))).only(
        FLOOR
    )
    power = np.abs(paths.amplitude) ** 2
    edges = np.arange(1.75, 6.01, 0.25)  # below the beam's null, where its side lobe meets the floor
    level = 10.0 * np.log10(np.histogram(paths.length, edges, weights=power)[0])
    assert edges[:-1][level > level.max() - 3.0].min() == pytest.approx(3.0, abs=0.26)
    assert level[edges[:-1] < 2.5].max() < level.max() - 7.0


def test_scattered_power_equals_the_loss_of_the_mirror_echo():
    """Mirror: exp(-2 k^2 s^2). Power of the patches: (1 - exp(-4 k^2 s^2)) area cos^2 / (pi d^4), Lambert's law."""
    for roughness, turn in ((0.5e-3, 0.0), (3e-3, 0.0), (3e-3, 40.0)):
        paths = arrivals(geometry(2.0, turn, setup=replace(EMPTY, roughness_m=roughness))).only(FACE)
        smooth = arrivals(geometry(2.0, turn)).only(FACE)
        cosine = np.cos(np.deg2rad(turn))
        unevenness = 2.0 * np.pi / WAVELENGTH * roughness * cosine
        np.testing.assert_allclose(paths.amplitude[: len(smooth)], smooth.amplitude * np.exp(-2.0 * unevenness**2))
        power = (np.abs(paths.amplitude[len(smooth) :]) ** 2).sum()
        expected = -np.expm1(-4.0 * unevenness**2) * np.pi * 0.1**2 * cosine**2 / np.pi / 2.0**4
        assert power == pytest.approx(expected, rel=0.1)


def test_zero_reflectance_has_no_echo():
    assert not len(arrivals(geometry(1.0, reflectance=0.0)).only(FACE))


def test_higher_reflector_is_further_off_the_axis():
    """A reflector 0.5 m above the sensor is equivalent to a level one and a pitched sonar, except for its tilt."""
    placed = geometry(2.0).poses
    raised = replace(placed, above=np.array([0.5]))
    assert np.linalg.norm(raised.centre[0]) == pytest.approx(2.0)
    assert raised.centre[0, 2] == 0.5


def test_vertical_gradient_bends_rays_by_a_tenth_of_a_degree_per_metre():
    """1 K/m: a ray leaves 0.3 degrees above the straight line to 6 m and arrives as much from above."""
    air = Air.of(19.0, 0.0)
    bend = Gradient(up=1.0).bend(air)[0]
    assert np.rad2deg(bend * 6.0 / 2.0) == pytest.approx(0.3, abs=0.01)
    speed = sound_speed(np.array([19.0, 20.0]), 0.0)
    assert bend == pytest.approx((speed[1] - speed[0]) / speed[0], rel=0.02)  # Snell's law: curvature c'/c


def test_gradient_ahead_acts_by_the_mean_temperature():
    air = Air.of(19.0, 0.0)
    row = np.zeros(1, dtype=int)
    took = air.delay(row, np.array([6.0]), 1.0)
    steps = np.arange(6000) * 1e-3 + 5e-4
    expected = 2.0 * np.sum(1e-3 / sound_speed(19.0 + steps, 0.0))
    assert took[0] == pytest.approx(expected, rel=3e-4)
