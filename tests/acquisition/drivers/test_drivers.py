"""Drivers of the Devantech sonars with their twins and with a scripted bus."""

import numpy as np
import pytest

from acquisition import DeviceError, GarbledError, NoAnswerError, Ping, SettingError, StaleError
from acquisition.bench import Rig, Unit
from acquisition.drivers import DRIVERS, Srf02, Srf08, Srf10, fire_all
from acquisition.twins.devantech import BadWire, Srf02Twin, Srf10Twin
from tests.acquisition.drivers.i2c_devices import QUIET, pair


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
