"""Drivers of the Devantech sonars with their twins and with a scripted bus."""

from dataclasses import replace

import numpy as np
import pytest
from smbus2 import i2c_msg

from acquisition import DeviceError, GarbledError, NoAnswerError, Ping, SettingError, StaleError
from acquisition.bench import Bus, Rig, Room, Setup, Unit
from acquisition.drivers import DRIVERS, Srf02, Srf08, Srf10, fire_all
from acquisition.twins.devantech import COUNT_US, OUTPUTS, BadWire, Srf02Twin, Srf08Twin, Srf10Twin
from acquisition.twins.simulated_sensor import PLACED, SimulatedSensor

QUIET = Setup(placement_m=0.0, placement_deg=0.0, tilt_deg=0.0, drift_c=0.0, post=None)


def pair(wire=None, setup=QUIET, **settings):
    twin = Srf08Twin(Rig(Unit.nominal(), setup), np.random.default_rng(0), wire=wire or BadWire())
    settings = {"gain": 20, "range_register": 140, **settings}
    return twin, Srf08(twin, sleep=twin.clock.sleep, clock=twin.clock, **settings)


class Scripted:
    """A bus that logs writes and has prepared answers."""

    def __init__(self, registers=bytes(34), revision=10, fail=None):
        self.log, self.registers, self.revision, self.fail = [], registers, revision, fail
        self.address, self.busy = 0x70, 0

    def write_byte_data(self, i2c_addr, register, value):
        self.log.append((i2c_addr, register, value))
        if self.fail:
            raise self.fail
        if register == 0 and value in (0x50, 0x51, 0x52):
            self.busy = 2  # reads
        if register == 0 and value >= 0xE0:
            self.address = value >> 1

    def read_byte_data(self, i2c_addr, register):
        if i2c_addr != self.address or self.fail:
            raise OSError(121, "Remote I/O error")
        self.busy -= 1
        return 77 if register else 0xFF if self.busy >= 0 else self.revision

    def close(self):
        pass

    def i2c_rdwr(self, *messages):
        pointer, answer = messages
        self.log.append(("pointer", list(pointer), answer.len))
        for k, byte in enumerate(self.registers):
            answer.buf[k] = bytes([byte])


def on(bus, **settings):
    return Srf08(bus, sleep=lambda s: None, clock=iter(np.arange(0.0, 1e4, 0.01)).__next__, **settings)


def test_ping_writes_gain_then_range_then_command_each_on_its_own():
    bus = Scripted()
    on(bus, gain=14, range_register=140, output="us").ping()
    assert bus.log == [(0x70, 1, 14), (0x70, 2, 140), (0x70, 0, 0x52), ("pointer", [2], 34)]


def test_echoes_are_unsigned_big_endian_and_end_at_the_first_zero():
    registers = bytes([0x00, 0x85, 0x01, 0x9E, 0x04, 0x10, 0, 0]) + bytes(26)
    echoes = on(Scripted(registers)).ping()
    assert echoes.ranges == pytest.approx((1.33, 4.14, 10.40))
    assert echoes.light == 77


def test_seventeen_echoes_all_come_through():
    registers = np.arange(1, 18).astype(">u2").tobytes()
    assert len(on(Scripted(registers)).ping().ranges) == 17


@pytest.mark.parametrize(("output", "metres"), [("cm", 1.0), ("inch", 2.54), ("us", 100 / 5800)])
def test_units(output, metres):
    registers = (100).to_bytes(2, "big") + bytes(32)
    assert on(Scripted(registers), output=output).ping().ranges[0] == pytest.approx(metres)


def test_address_change_is_a0_aa_a5_new():
    bus = Scripted()
    sonar = on(bus)
    sonar.set_address(0x79)
    assert [value for _, _, value in bus.log] == [0xA0, 0xAA, 0xA5, 0xF2]
    assert sonar.address == 0x79


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"gain": 49},
            r"SRF08 gain must be a whole number from 0 to 31, got 49 \(code; the manual's table ends at 31\)",
        ),
        ({"gain": -1}, r"SRF08 gain must be a whole number from 0 to 31, got -1"),
        ({"range_register": 256}, r"SRF08 range register must be .* 0 to 255, got 256 \(steps of 43 mm\)"),
        ({"address": 0xE0}, r"SRF08 address must lie from 0x70 to 0x7F \(7 bits\), got 0xE0: halve an 8-bit address"),
        ({"output": "mm"}, "SRF08 output must be one of inch, cm, us, got 'mm'"),
    ],
)
def test_settings_are_refused_with_limit_value_and_unit(settings, message):
    with pytest.raises(SettingError, match=message):
        Srf08(Scripted(), **settings)


def test_a_missing_sensor_is_no_answer_after_three_tries():
    bus = Scripted(fail=OSError(121, "Remote I/O error"))
    with pytest.raises(NoAnswerError, match=r"SRF08 at 0x70: no acknowledge in 3 tries 1 ms apart; no sonar"):
        on(bus).ping()
    assert len(bus.log) == 3


def test_a_broken_bus_is_a_device_error():
    with pytest.raises(DeviceError, match="the bus failed: No such device"):
        on(Scripted(fail=OSError(19, "No such device"))).ping()


@pytest.mark.parametrize("revision", [0xFF, 0])
def test_waiting_is_bounded(revision):
    with pytest.raises(NoAnswerError, match="still busy 136 ms after a ping"):
        on(Scripted(revision=revision), range_register=140).ping()


def test_open_line_in_the_registers_is_no_answer():
    with pytest.raises(NoAnswerError, match="0xFFFF"):
        on(Scripted(b"\xff" * 34)).ping()


def test_a_missing_bus_is_an_error(monkeypatch):
    with pytest.raises(DeviceError, match=r"/dev/i2c-987: .*; enable I2C"):
        DRIVERS["srf08"].open("/dev/i2c-987")


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


def test_each_fault_of_the_wire_raises_its_own_error():
    twin, sonar = pair()
    twin.place(Ping.of(distance=1.0, reflectance=0.9))
    assert sonar.ping().ranges
    twin.wire.lost_write = 1.0
    twin.place(Ping.of(distance=2.0, reflectance=0.9))
    with pytest.raises(StaleError, match="the command was lost"):
        sonar.ping()
    twin.wire = BadWire(stuck=True)
    with pytest.raises(NoAnswerError, match="still busy"):
        sonar.ping()
    twin.wire = BadWire(nack=1.0)
    with pytest.raises(NoAnswerError, match="no acknowledge"):
        sonar.ping()
    twin.wire = BadWire()
    assert sonar.ping().ranges[0] == pytest.approx(2.02, abs=0.03)


def test_transfers_are_repeated_after_a_missing_acknowledge():
    twin, sonar = pair(wire=BadWire(nack=0.1))
    twin.place(Ping.of(distance=1.0, reflectance=0.9))
    assert all(len(sonar.ping().ranges) for _ in range(20))


def test_general_call_starts_the_sonar():
    twin, _ = pair()
    twin.write_byte_data(0, 0, 0x51)
    with pytest.raises(OSError, match="Remote I/O"):
        twin.read_byte_data(0x70, 0)
    with pytest.raises(OSError, match="Remote I/O"):
        twin.read_byte_data(0, 0)


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


def test_a_wrong_address_is_an_error_with_the_addresses_found():
    twin, _ = pair()
    wrong = Srf08(twin, address=0x72, sleep=twin.clock.sleep, clock=twin.clock)
    with pytest.raises(NoAnswerError, match=r"SRF08 at 0x72: .* found 0x70 instead"):
        wrong.ping()


def test_the_address_is_not_changed_while_another_sonar_is_on_the_bus():
    class Two(Scripted):
        def read_byte_data(self, i2c_addr, register):
            if i2c_addr not in (0x70, 0x74):
                raise OSError(121, "Remote I/O error")
            return 10

    bus = Two()
    with pytest.raises(SettingError, match="must be alone on the bus, also found 0x74"):
        on(bus).set_address(0x79)
    assert bus.log == []


def test_ann_mode_sets_the_gate_of_the_wall():
    """A wall at 2.00 m comes back after 11.65 ms, in the sixth gate of 2.048 ms."""
    twin, sonar = pair(output="us")
    twin.place(Ping.of(distance=2.0, reflectance=0.9))
    gates = sonar.gates()
    assert gates.first == pytest.approx(2.0, abs=0.05)
    assert len(gates.values) == 32
    assert next(k for k, value in enumerate(gates.values) if value) == 5
    assert twin.range_register == 255


def test_general_call_then_fetch_gives_the_same_wall():
    twin, sonar = pair(range_register=255, gain=31)
    twin.place(Ping.of(distance=1.0, reflectance=0.9))
    fire_all([sonar])
    assert sonar.fetch().ranges[0] == pytest.approx(1.01, abs=0.03)


@pytest.mark.parametrize(("kind", "twin_kind"), [(Srf10, Srf10Twin), (Srf02, Srf02Twin)])
def test_srf10_and_srf02_return_one_echo(kind, twin_kind):
    twin = twin_kind(Rig(Unit.nominal(), QUIET), np.random.default_rng(0))
    sonar = kind(twin, sleep=twin.clock.sleep, clock=twin.clock)
    twin.place(Ping.of(distance=1.5, reflectance=0.9))
    assert sonar.ping().ranges == pytest.approx((1.51,), abs=0.03)
    assert sonar.ping().light is None


def test_srf02_reads_its_minimum_range():
    twin = Srf02Twin(Rig(Unit.nominal(), QUIET), np.random.default_rng(0))
    assert Srf02(twin, sleep=twin.clock.sleep, clock=twin.clock).min_range() == pytest.approx(0.16)


@pytest.mark.parametrize(("output", "count_m"), [("cm", 0.01), ("inch", 0.0254), ("us", 0.01 / 58.0)])
def test_the_minimum_range_of_an_srf02_has_the_unit_of_its_ranging(output, count_m):
    twin = Srf02Twin(Rig(Unit.nominal(), QUIET), np.random.default_rng(0))
    sonar = Srf02(twin, output=output, sleep=twin.clock.sleep, clock=twin.clock)
    sonar.ping()
    assert 0.16 - 1e-9 <= sonar.min_range() < 0.16 + count_m


def test_srf10_has_17_gains():
    with pytest.raises(SettingError, match="SRF10 gain must be a whole number from 0 to 16, got 17"):
        Srf10(Scripted(), gain=17)


def test_an_echo_beyond_the_maximum_range_is_an_error():
    """The sensor was reset to range register 255 unnoticed."""
    registers = (1000).to_bytes(2, "big") + bytes(32)
    with pytest.raises(GarbledError, match=r"echo at 10.00 m, beyond its set maximum of 6\.6.* m"):
        on(Scripted(registers), range_register=140).ping()


def test_a_lost_general_call_is_an_error():
    twin, sonar = pair()
    sonar.ping()
    twin.wire.lost_write = 1.0
    with pytest.raises(StaleError, match="the command was lost"):
        fire_all([sonar])


def test_a_general_call_has_one_unit():
    with pytest.raises(SettingError, match="all with the same output"):
        fire_all([on(Scripted()), on(Scripted(), output="us")])


@pytest.mark.parametrize("range_register", [24, 77, 140])
def test_a_lost_ann_command_is_an_error(range_register):
    twin, sonar = pair(range_register=range_register)
    sonar.ping()
    twin.wire.lost_write = 1.0
    with pytest.raises(StaleError, match="the command was lost"):
        sonar.gates()


class SlowHost:
    """A bus on a busy host: the first checks of a sensor are late."""

    def __init__(self, twin, late):
        self.twin, self.late = twin, late

    def read_byte_data(self, i2c_addr, register):
        if register == 0 and self.late:
            self.late -= 1
            self.twin.clock.sleep(0.05)
        return self.twin.read_byte_data(i2c_addr, register)

    def __getattr__(self, name):
        return getattr(self.twin, name)


def test_a_host_that_checks_too_late_fires_again():
    twin, sonar = pair()
    twin.place(Ping.of(distance=1.0, reflectance=0.9))
    sonar.bus = SlowHost(twin, 2)
    assert sonar.ping().ranges
    assert twin.clock() > 2 * 0.065
    sonar.bus = SlowHost(twin, 1000)
    with pytest.raises(NoAnswerError, match=r"3 times too slow to check a ranging command.* 36 ms only"):
        sonar.ping()


def test_a_slow_host_detects_a_lost_command():
    twin, sonar = pair()
    sonar.ping()
    twin.wire.lost_write = 1.0
    sonar.bus = SlowHost(twin, 2)
    with pytest.raises(StaleError, match="the command was lost"):
        sonar.ping()


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
