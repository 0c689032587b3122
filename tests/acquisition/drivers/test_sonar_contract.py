"""Contract of all sonars: the twins and, with `--hardware PORT --sonar NAME`, a real sonar facing a wall."""

import numpy as np
import pytest

from acquisition import Ping
from acquisition.bench import Rig, Setup, Unit, Wall
from acquisition.drivers import DRIVERS, ArduinoBus, Bridge, HcSr04, MaxBotix, MaxBotixPwm, Srf02, Srf08, Srf10
from acquisition.twins.devantech import Srf02Twin, Srf08Twin, Srf10Twin
from acquisition.twins.simulated_sensor import TwinClock
from tests.acquisition.drivers.serial_devices import ArduinoTwin, HcSr04Twin, MaxBotixTwin, TwinPort

SETTINGS = {"gain": 20, "range_register": 140}
UNITS = ("cm", "us", "inch")


def twin_of(kind, clock):
    twin = kind(Rig(Unit.draw(11), Setup(reflector=Wall())), np.random.default_rng(0), clock=clock)
    twin.place(Ping.of(distance=1.2))
    return twin


def bridge(board, clock):
    made = Bridge(TwinPort(board, clock), clock=clock)
    made.handshake()
    return made


def on_bus(driver, kind):
    def opened(**settings):
        clock = TwinClock()
        return driver(twin_of(kind, clock), sleep=clock.sleep, clock=clock, **settings)

    return opened


def at_arduino(driver, kind):
    def opened(**settings):
        clock = TwinClock()
        return driver(
            ArduinoBus(bridge(ArduinoTwin(twin_of(kind, clock)), clock)), sleep=clock.sleep, clock=clock, **settings
        )

    return opened


def hcsr04():
    clock = TwinClock()
    return HcSr04(bridge(ArduinoTwin(None, twin_of(HcSr04Twin, clock)), clock))


def maxbotix():
    clock = TwinClock()
    return MaxBotix(TwinPort(twin_of(MaxBotixTwin, clock), clock), clock=clock)


def maxbotix_pwm():
    clock = TwinClock()
    return MaxBotixPwm(bridge(ArduinoTwin(pwm=twin_of(MaxBotixTwin, clock)), clock))


TWINS = {
    "srf08": on_bus(Srf08, Srf08Twin),
    "srf10": on_bus(Srf10, Srf10Twin),
    "srf02": on_bus(Srf02, Srf02Twin),
    "srf08 at an Arduino": at_arduino(Srf08, Srf08Twin),
    "hcsr04": hcsr04,
    "maxbotix": maxbotix,
    "maxbotix-pwm": maxbotix_pwm,
}


@pytest.fixture(params=[*TWINS, "hardware"])
def opened(request):
    """Return a function that opens the sonar with settings, and its name."""
    port, sonar = request.config.getoption("--hardware"), request.config.getoption("--sonar")
    if request.param != "hardware":
        return TWINS[request.param], request.param.split()[0]
    if port is None:
        pytest.skip("no real sonar: give its port with --hardware PORT, and its name with --sonar NAME")
    return lambda **settings: DRIVERS[sonar].open(port, **settings), sonar


@pytest.fixture
def srf08(opened):
    if opened[1] != "srf08":
        pytest.skip("registers of the SRF08")
    return opened[0]


def test_the_wall_is_detected_and_echoes_are_in_order(opened):
    sonar = opened[0]()
    for _ in range(5):
        ranges = sonar.ping().ranges
        assert 0.25 < ranges[0] < 3.2
        assert list(ranges) == sorted(ranges)
        assert len(ranges) <= 17


def test_readings_are_repeatable(opened):
    sonar = opened[0]()
    first = [sonar.ping().ranges[0] for _ in range(9)]
    assert np.ptp(first) < 0.06


def test_revision_and_light(srf08):
    sonar = srf08(**SETTINGS)
    assert 0 < sonar.revision() < 255
    assert 0 <= sonar.light() <= 255


def test_three_units_agree(srf08):
    first = {unit: np.median([srf08(**SETTINGS, output=unit).ping().ranges[0] for _ in range(5)]) for unit in UNITS}
    assert first["cm"] == pytest.approx(first["us"], abs=0.02)
    assert first["inch"] == pytest.approx(first["us"], abs=0.035)


def test_no_echo_lies_beyond_the_range_register(srf08):
    ranges = [range_ for _ in range(5) for range_ in srf08(gain=31, range_register=100).ping().ranges]
    assert all(range_ <= 101 * 0.0443 for range_ in ranges)


def test_less_gain_gives_no_more_echoes(srf08):
    counts = [np.mean([len(srf08(gain=gain, range_register=200).ping().ranges) for _ in range(5)]) for gain in (0, 31)]
    assert counts[0] <= counts[1]


def test_ann_mode_agrees_on_the_first_echo(srf08):
    sonar = srf08(**SETTINGS)
    assert sonar.gates().first == pytest.approx(sonar.ping().ranges[0], abs=0.05)
