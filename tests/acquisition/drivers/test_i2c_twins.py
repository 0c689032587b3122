"""Twins of the Devantech sonars answer on the bus as the sensors do."""

from dataclasses import replace

import numpy as np
import pytest
from smbus2 import i2c_msg

from acquisition import NoAnswerError, Ping
from acquisition.bench import Bus, Rig, Room, Unit
from acquisition.drivers import Srf08
from acquisition.twins.devantech import COUNT_US, OUTPUTS, Srf02Twin, Srf08Twin, Srf10Twin
from acquisition.twins.simulated_sensor import PLACED, SimulatedSensor
from tests.acquisition.drivers.i2c_devices import QUIET, pair


def test_driver_measures_through_the_twin():
    twin, sonar = pair()
    twin.place(Ping.of(distance=1.0, reflectance=0.9))
    assert sonar.ping().ranges[0] == pytest.approx(1.01, abs=0.02)
    twin.place(Ping.of(distance=5.9, reflectance=0.1))
    assert sonar.ping().ranges == ()
    assert sonar.revision() == 10
    assert sonar.light() == Unit.nominal().light


def test_twin_and_rig_agree_on_the_registers():
    twin, sonar = pair(output="us")
    twin.place(Ping.of(distance=1.5, reflectance=0.9))
    readings = [sonar.ping().ranges[0] for _ in range(20)]
    setup = replace(QUIET, gain=20, output="us")
    ping = Ping.of(distance=1.5, reflectance=0.9, time=np.arange(20) * 2.4)
    reading = Rig(Unit.nominal(), setup).ping(ping, np.random.default_rng(1)).reading(setup)
    assert np.median(readings) == pytest.approx(np.median(reading.range), abs=0.005)


@pytest.mark.parametrize("ones", [True, False], ids=["0xFF", "NACK"])
def test_busy_lasts_as_long_as_listening(ones):
    twin, _ = pair()
    twin.busy_reads_ones = ones
    twin.write_byte_data(0x70, 2, 140)
    twin.write_byte_data(0x70, 0, 0x51)
    twin.clock.sleep(0.036)
    if ones:
        assert twin.read_byte_data(0x70, 0) == 0xFF
    else:
        with pytest.raises(OSError, match="Remote I/O"):
            twin.read_byte_data(0x70, 0)
    twin.clock.sleep(0.002)
    assert twin.read_byte_data(0x70, 0) == 10


def test_the_twin_changes_its_address_only_after_the_full_sequence():
    twin, sonar = pair()
    for value in (0xA5, 0xAA, 0xA0, 0xF2):
        twin.write_byte_data(0x70, 0, value)
    assert twin.address == 0x70
    sonar.set_address(0x79)
    assert twin.address == 0x79
    assert sonar.revision() == 10
    with pytest.raises(NoAnswerError):
        Srf08(twin, address=0x70, sleep=twin.clock.sleep, clock=twin.clock).revision()


def test_each_ping_writes_the_settings_again_after_a_reset():
    twin, sonar = pair(gain=3)
    sonar.ping()
    twin.power_cycle()
    assert twin.gain == 31
    sonar.ping()
    assert (twin.gain, twin.range_register) == (3, 140)


def test_a_sensor_that_lost_power_has_no_echoes_and_is_idle():
    twin, sonar = pair()
    twin.place(Ping.of(distance=1.0, reflectance=0.9))
    assert sonar.ping().ranges
    sonar.fire()
    twin.power_cycle()
    assert not any(sonar.counts())


def test_the_registers_of_a_twin_decide_not_those_of_a_recorded_ping():
    twin, sonar = pair(gain=31, range_register=140)
    twin.place(Ping.of(distance=3.0, reflectance=0.9, gain=0.0, range_mm=1075.0))
    assert sonar.ping().ranges[0] == pytest.approx(3.02, abs=0.05)


def test_faults_of_a_twins_wire_are_those_of_its_own_wire():
    twin, sonar = pair(setup=replace(QUIET, bus=Bus(dropped=1.0)))
    twin.place(Ping.of(distance=1.0, reflectance=0.9))
    assert sonar.ping().ranges


def test_twin_speaks_i2c_messages():
    twin, sonar = pair()
    twin.place(Ping.of(distance=1.0, reflectance=0.9))
    sonar.ping()
    answer = i2c_msg.read(0x70, 4)
    twin.i2c_rdwr(i2c_msg.write(0x70, [0]), answer)
    assert list(answer)[:2] == [10, Unit.nominal().light]


def test_the_twin_receives_echoes_of_the_previous_ping():
    """At 32 ms intervals a distant wall reads as a near one; after 2 s it does not."""
    unit = replace(Unit.nominal(), sensitivity_db=25.0, leak_db=-300.0, noise=0.01)
    setup = replace(QUIET, room=Room(None, None, 8.0))
    twin = Srf08Twin(Rig(unit, setup), np.random.default_rng(0))
    sonar = Srf08(twin, gain=31, range_register=120, sleep=twin.clock.sleep, clock=twin.clock)
    began = twin.clock()
    assert sonar.ping().ranges == ()
    again = sonar.ping().ranges
    interval = 0.032  # listening and read-out
    assert twin.clock() - began == pytest.approx(2 * interval, abs=0.004)
    assert again[0] == pytest.approx(8.0 - 0.5 * 343.36 * interval, abs=0.15)
    twin.clock.sleep(2.0)
    assert sonar.ping().ranges == ()


def test_a_late_ping_of_the_twin_is_that_of_the_rig_alone():
    twin = SimulatedSensor(Rig(Unit.nominal(), QUIET), np.random.default_rng(0))
    placed = Ping.of(distance=1.0, reflectance=0.9)
    twin.place(placed)
    for gap in (0.1, 0.2):
        twin.fire("us")
        twin.clock.sleep(gap)
        twin.rng = np.random.default_rng(1)
        alone = Rig(Unit.nominal(), replace(QUIET, gain=31, output="us", range_register=255, **PLACED))
        drift = alone.draw_drift(np.random.default_rng(2))  # without effect in this laboratory
        code = alone.ping(replace(placed, time=np.array([twin.clock()])), np.random.default_rng(1), drift).code[-1]
        assert np.array_equal(twin.fire("us"), code) == (gap > 0.15)


@pytest.mark.parametrize(("kind", "nearest"), [(Srf02Twin, 0.16), (Srf10Twin, 0.06)])
@pytest.mark.parametrize("output", ["cm", "inch", "us"])
def test_no_echo_from_below_the_minimum_range_is_registered(kind, nearest, output):
    code = {each: number for number, each in OUTPUTS.items()}[output]
    for distance in (0.01, 0.03, 0.05, 0.1, 0.15, 0.3):
        twin = kind(Rig(Unit.nominal(), QUIET), np.random.default_rng(0))
        twin.place(Ping.of(distance=distance, reflectance=0.9))
        twin.write_byte_data(0x70, 0, code)
        twin.clock.sleep(1.0)
        count = 256 * twin.read_byte_data(0x70, 2) + twin.read_byte_data(0x70, 3)
        reading = count * COUNT_US[output] * 0.01 / 58.0
        assert reading == 0.0 or reading >= nearest
        if distance >= nearest + 0.03:
            assert reading == pytest.approx(distance, abs=0.02)
