"""The rig against brute force: every facet of the surface, real voltages at 2 MHz, and laws that hold for any unit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import Ping
from acquisition.bench import Disc, Plate, Rig, Room, Setup, Unit, Wall
from acquisition.bench.acoustics.geometry import REFERENCE
from acquisition.bench.acoustics.receiver import GAINS
from acquisition.bench.acoustics.room import between_images
from acquisition.bench.acoustics.transducer import Piston, reference_peak
from acquisition.bench.laboratory.air import absorption_db, sound_speed

STEP = 0.5e-6
ALONE = Setup.static(output="us")
QUIET = replace(Unit.nominal(), noise=0.0, leak_db=-300.0, t_offset=0.0)


def resonate(drive, f0, quality):
    """A second-order resonator, driven: y'' + w/Q y' + w^2 y = w/Q x', by the trapezoidal rule on its two states."""
    w = 2.0 * np.pi * f0
    matrix = np.array([[-w / quality, -w], [w, 0.0]])
    source = np.array([w / quality, 0.0])
    left = np.linalg.inv(np.eye(2) - 0.5 * STEP * matrix)
    step, inject = left @ (np.eye(2) + 0.5 * STEP * matrix), left @ source * STEP
    state, out = np.zeros(2), np.zeros(len(drive))
    middle = 0.5 * (drive + np.append(drive[1:], 0.0))
    for k in range(len(drive) - 1):
        state = step @ state + inject * middle[k]
        out[k + 1] = state[0]
    return out


@pytest.fixture(scope="module")
def pulse():
    """Voltage of the echo of a point: a sine burst through two resonators, with a peak of 1 for the nominal unit."""
    t = np.arange(0.0, 5e-3, STEP)
    burst = np.where(t < 200e-6, np.sin(2.0 * np.pi * 40e3 * t), 0.0)
    return resonate(resonate(burst, 40e3, 35.0), 40e3, 35.0) / reference_peak()


def facets(shape, step):
    """Centres of a plate's facets about its centre, (m, 2), and the area of one."""
    half = (shape.radius, shape.radius) if isinstance(shape, Disc) else shape.half
    count = [int(np.ceil(2.0 * h / step)) for h in half]
    axes = [(np.arange(n) + 0.5) / n * 2.0 * h - h for n, h in zip(count, half, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    if isinstance(shape, Disc):
        grid = grid[(grid**2).sum(axis=1) < shape.radius**2]
    return grid, shape.area / len(grid)


def brute_crossing(pulse, shape, distance, incidence, gain, output_samples=40_000):
    """Kirchhoff's surface integral facet by facet, then the first time that the voltage trips the comparator, s.

    p = sum dS h/(2 pi r^3) [s'(t - 2r/c)/c + s(t - 2r/c)/r] for a plane at distance h.
    """
    speed, loss = float(sound_speed(19.0)), float(absorption_db(19.0))
    plane, area = facets(shape, 1.0e-3)
    x = distance * np.cos(incidence)  # reflector parallel to the sensor's face: plane at x, centre aside
    y, z = plane[:, 0] + distance * np.sin(incidence), plane[:, 1]
    r = np.sqrt(x**2 + y**2 + z**2)
    beam = Piston(2.0 * np.pi * 40e3 / speed * QUIET.radius)(np.arccos(x / r)) ** 2
    path = 2.0 * np.hypot(r, QUIET.baseline / 2.0)
    weight = area * x / (2.0 * np.pi * r**3) * beam * 10.0 ** (-loss * path / 20.0)
    index, share = np.divmod(path / speed / STEP, 1.0)
    index = index.astype(int)

    def gathered(w):
        bins = np.bincount(index, w * (1.0 - share), output_samples) + np.bincount(index + 1, w * share, output_samples)
        size = 2 * output_samples
        return np.fft.irfft(np.fft.rfft(bins, size) * np.fft.rfft(pulse, size), size)[:output_samples]

    t = np.arange(output_samples) * STEP
    voltage = np.gradient(gathered(weight), STEP) / speed + gathered(weight / r)
    table = np.array(GAINS)[np.minimum((t / 70e-6 + 1e-9).astype(int), gain)] / 1025.0
    voltage *= REFERENCE * 10.0 ** (QUIET.sensitivity_db / 20.0) * table
    over = np.flatnonzero((voltage >= 1.0 + 0.5 * QUIET.hysteresis) & (t > QUIET.blanking))
    return t[over[0]] if len(over) else None


@pytest.mark.parametrize(
    ("shape", "distance", "incidence_deg", "gain"),
    [
        (Disc(0.1), 0.5, 0.0, 20),
        (Disc(0.1), 0.8, 3.0, 14),
        (Disc(0.1), 1.2, 0.0, 20),
        (Disc(0.1), 1.0, 9.0, 31),
        (Plate(0.12, 0.13), 0.6, 2.0, 14),
        (Plate(0.12, 0.13), 1.5, 1.0, 20),
        (Plate(0.12, 0.13), 0.7, 14.0, 31),
    ],
)
def test_first_crossing_equals_that_of_the_full_voltage(pulse, shape, distance, incidence_deg, gain):
    incidence = np.deg2rad(incidence_deg)
    setup = replace(ALONE, gain=gain, reflector=shape)
    ping = Ping.of(distance=distance, angle=incidence, reflectance=1.0)
    code = Rig(QUIET, setup).ping(ping, np.random.default_rng(0)).code[0, 0]
    expected = brute_crossing(pulse, shape, distance, incidence, gain)
    assert expected is not None
    assert code == pytest.approx(expected * 1e6, abs=3.0)


UNITS = st.integers(1, 10_000).map(Unit.draw)
ANY_SETUP = replace(ALONE, post=Setup().post, room=Room())


@settings(max_examples=25, deadline=None)
@given(unit=UNITS, distance=st.floats(0.4, 4.0), extra=st.floats(0.1, 12.0))
def test_stronger_echo_is_neither_later_nor_lost(unit, distance, extra):
    """Of a wall, without noise: raising the level can only move the first crossing to an earlier period."""
    unit = replace(unit, noise=0.0, leak_db=-300.0)
    rig = Rig(unit, replace(ALONE, gain=20, reflector=Wall()))
    louder = replace(rig, unit=replace(unit, sensitivity_db=unit.sensitivity_db + extra))
    codes = [int(r.ping(Ping.of(distance=distance), np.random.default_rng(0)).code[0, 0]) for r in (rig, louder)]
    assert codes[0] == 0 or 0 < codes[1] <= codes[0]


@settings(max_examples=25, deadline=None)
@given(
    unit=UNITS,
    gain=st.integers(0, 31),
    gate=st.integers(10, 255),
    angle=st.floats(-0.7, 0.7),
    distance=st.floats(0.03, 6.0),
    reflectance=st.floats(0.0, 1.0),
    seed=st.integers(0, 100),
)
def test_registers_are_in_order_spaced_by_the_dead_time_and_inside_the_gate(
    unit, gain, gate, angle, distance, reflectance, seed
):
    setup = replace(ANY_SETUP, gain=gain, range_register=gate)
    ping = Ping.of(distance=np.full(3, distance), angle=angle, reflectance=reflectance, time=np.arange(3) * 2.4)
    code = Rig(unit, setup).ping(ping, np.random.default_rng(seed)).code.astype(int)
    detected = code > 0
    assert (detected[:, :-1] | ~detected[:, 1:]).all()  # zero-terminated
    assert code.max() <= (gate + 1) * 256 + unit.tick * 1e6
    steps = np.diff(code, axis=1)[detected[:, 1:]]
    assert (steps >= unit.rearm * (1.0 + unit.clock_error) * 1e6 - unit.tick * 1e6 - 1.0).all()


@settings(max_examples=20, deadline=None)
@given(
    distance=st.floats(0.2, 3.0),
    angle=st.floats(0.0, 0.7),
    incidence=st.floats(0.0, 0.7),
    reflectance=st.sampled_from([0.1, 0.9]),
)
def test_mirror_symmetry(distance, angle, incidence, reflectance):
    """A beam along the housing's axis is symmetric."""
    rig = Rig(QUIET, replace(ANY_SETUP, gain=31))
    sides = [Ping.of(distance, sign * angle, sign * incidence, reflectance) for sign in (1.0, -1.0)]
    left, right = (rig.ping(side, np.random.default_rng(0)).code[0].astype(int) for side in sides)
    assert np.abs(left - right).max() <= 1


def brute_between(shape, first, second, wavelength):
    """Kirchhoff's integral over the facets of a plate for sound from one place to another, a continuous wave.

    p = i k/(2 pi) sum dS (cos of incidence + cos of emission)/2 e^(-i k (r + s))/(r s)
    """
    plane, area = facets(shape, 0.7e-3)
    a, b = (end + np.concatenate([plane, np.zeros((len(plane), 1))], axis=1) for end in (first, second))
    r, s = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    slant = 0.5 * (a[:, 2] / r + b[:, 2] / s)
    return (1j / wavelength * area * slant / (r * s) * np.exp(-2j * np.pi * (r + s) / wavelength)).sum()


@pytest.mark.parametrize("shape", [Disc(0.1), Plate(0.12, 0.13)], ids=["disc", "plate"])
@pytest.mark.parametrize(
    ("first", "second"),
    [
        ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0)),  # from the sensor itself: the mirror echo
        ((0.02, 0.6, 0.5), (0.02, 0.0, 0.5)),  # by a near floor
        ((0.05, 0.8, 1.0), (0.05, 0.8, 1.0)),  # by the floor there and back
        ((0.3, 2.0, 1.0), (0.3, 0.0, 1.0)),
        ((-0.4, 0.7, 1.2), (-0.4, -0.5, 1.2)),  # floor and ceiling: mirrored near the rim
        ((0.0, 0.05, 2.0), (0.0, -0.04, 2.2)),
    ],
)
def test_plate_between_two_images_is_kirchhoff_s_integral(shape, first, second):
    """Within 3 % of a mirror's echo, or a twentieth of its own."""
    wavelength, ends = 8.584e-3, [np.array([end]) for end in (first, second)]
    length, amplitude = between_images(shape, *ends, np.array([wavelength]))
    found = (amplitude * np.exp(-4j * np.pi * length / wavelength)).sum()
    expected = brute_between(shape, *ends, wavelength)
    mirror = 1.0 / (np.linalg.norm(first) + np.linalg.norm(second))
    assert abs(found - expected) < max(0.03 * mirror, 0.05 * abs(expected))
