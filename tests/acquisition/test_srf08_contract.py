"""What any SRF08 must do, the twin and, with `--hardware BUS`, a real one with a wall 0.3 to 3 m before it."""

import numpy as np
import pytest

from acquisition import Ping
from acquisition.bench import Rig, Setup, Unit, Wall
from acquisition.drivers import Srf08
from acquisition.drivers.twins import Srf08Twin

SETTINGS = {"gain": 20, "range_register": 140}
UNITS = ("cm", "us", "inch")


def over_twin(**settings):
    twin = Srf08Twin(Rig(Unit.draw(11), Setup(reflector=Wall())), np.random.default_rng(0))
    twin.place(Ping.of(distance=1.2))
    return Srf08(twin, sleep=twin.clock.sleep, clock=twin.clock, **settings)


@pytest.fixture(params=["twin", "hardware"])
def opened(request):
    """How to open the sonar with given settings."""
    bus = request.config.getoption("--hardware")
    if request.param == "twin":
        return over_twin
    if bus is None:
        pytest.skip("no real SRF08: give its bus with --hardware BUS")
    return lambda **settings: Srf08.open(bus, **settings)


def test_it_says_who_it_is(opened):
    sonar = opened(**SETTINGS)
    assert 0 < sonar.revision() < 255
    assert 0 <= sonar.light() <= 255


def test_it_hears_the_wall_and_gives_echoes_in_order(opened):
    sonar = opened(**SETTINGS)
    for _ in range(5):
        ranges = sonar.ping().ranges
        assert 0.25 < ranges[0] < 3.2
        assert list(ranges) == sorted(ranges)
        assert len(ranges) <= 17


def test_three_units_say_the_same(opened):
    first = {unit: np.median([opened(**SETTINGS, output=unit).ping().ranges[0] for _ in range(5)]) for unit in UNITS}
    assert first["cm"] == pytest.approx(first["us"], abs=0.02)
    assert first["inch"] == pytest.approx(first["us"], abs=0.035)


def test_nothing_is_heard_beyond_the_range_register(opened):
    ranges = [range_ for _ in range(5) for range_ in opened(gain=31, range_register=40).ping().ranges]
    assert all(range_ <= 41 * 0.0443 for range_ in ranges)


def test_less_gain_hears_no_more(opened):
    counts = [np.mean([len(opened(gain=gain, range_register=200).ping().ranges) for _ in range(5)]) for gain in (0, 31)]
    assert counts[0] <= counts[1]
