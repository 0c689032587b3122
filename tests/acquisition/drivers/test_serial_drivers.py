"""The Arduino bridge, HC-SR04 and MaxBotix over their twins, by pseudo-terminal (pyserial runs) or in memory."""

import numpy as np
import pytest

from acquisition import (
    BoardResetError,
    DeviceError,
    GarbledError,
    NoAnswerError,
    OutOfSequenceError,
    Ping,
    SettingError,
    UnpluggedError,
)
from acquisition.bench import Rig, Setup, Unit
from acquisition.drivers import ArduinoBus, Bridge, HcSr04, MaxBotix, Srf08
from acquisition.drivers.arduino import checked, parse
from acquisition.drivers.maxbotix import MODELS
from acquisition.twins.devantech import BadWire, Srf08Twin
from acquisition.twins.serial_devices import ArduinoTwin, HcSr04Twin, MaxBotixTwin, PseudoTerminal, TwinPort
from acquisition.twins.simulated_sensor import HostClock, TwinClock

QUIET = Setup(placement_m=0.0, placement_deg=0.0, tilt_deg=0.0, drift_c=0.0, post=None)
WALL = Ping.of(distance=1.0, reflectance=0.9)


def ear(kind, clock, ping=WALL, **settings):
    twin = kind(Rig(Unit.nominal(), QUIET), np.random.default_rng(0), clock=clock, **settings)
    twin.place(ping)
    return twin


def board(**settings):
    """A board in memory with an SRF08 and an HC-SR04, its bridge, and the clock of both."""
    clock = TwinClock()
    twin = ArduinoTwin(ear(Srf08Twin, clock), ear(HcSr04Twin, clock), **settings)
    bridge = Bridge(TwinPort(twin, clock), clock=clock)
    return twin, bridge, clock


def greeted():
    twin, bridge, clock = board()
    bridge.greet()
    return twin, bridge, clock


def test_checksum_is_the_published_one():
    """CRC-16/CCITT-FALSE of "123456789" is 0x29B1 in every catalogue of checksums."""
    assert checked("123456789") == "123456789*29B1"


@pytest.mark.parametrize("line", [b"", b"<01 K*0000", b"01 K", b"<01 Q*FFFF", b"\xff\xfe", b"<01 K 00*12"])
def test_lines_that_are_none_are_garbled(line):
    with pytest.raises(GarbledError, match="garbled line"):
        parse(line)


def test_any_single_bit_that_flips_is_noticed():
    line = b"<" + checked("07 K 0085").encode()
    for k in range(8 * len(line)):
        wrong = bytearray(line)
        wrong[k // 8] ^= 1 << k % 8
        with pytest.raises(GarbledError):
            parse(bytes(wrong))


def test_srf08_behind_the_board_is_the_srf08_on_the_bus():
    _, bridge, clock = greeted()
    sonar = Srf08(ArduinoBus(bridge), gain=20, range_register=140, sleep=clock.sleep, clock=clock)
    direct = ear(Srf08Twin, TwinClock())
    near = Srf08(direct, gain=20, range_register=140, sleep=direct.clock.sleep, clock=direct.clock)
    assert sonar.ping().ranges[0] == pytest.approx(near.ping().ranges[0], abs=0.02)
    assert sonar.light() == near.light()


def test_a_missing_acknowledge_behind_the_board_names_sensor_and_addresses():
    _, bridge, clock = greeted()
    sonar = Srf08(ArduinoBus(bridge), address=0x75, sleep=clock.sleep, clock=clock)
    with pytest.raises(NoAnswerError, match=r"SRF08 at 0x75: no acknowledge .* found 0x70 instead"):
        sonar.ping()


def test_a_reset_is_noticed_and_the_next_ping_works():
    twin, bridge, _ = greeted()
    sonar = HcSr04(bridge)
    sonar.ping()
    twin.reset()
    with pytest.raises(BoardResetError, match="started anew"):
        sonar.ping()
    assert sonar.ping().ranges


def test_answers_to_other_questions_are_dropped_by_name():
    twin, bridge, clock = greeted()
    twin.repeat = True
    began = clock()
    with pytest.raises(OutOfSequenceError, match=r"awaited answer .*, got only"):
        bridge.ask("V")
    assert clock() - began < 0.6


def test_a_late_answer_is_never_taken_for_the_next():
    twin, bridge, _ = greeted()
    kept = []
    twin.mangle = lambda due: kept.append(due) or b""
    with pytest.raises(NoAnswerError, match="no answer within"):
        bridge.ask("R 70 00 01")
    twin.mangle = lambda due: b"".join(kept) + due
    assert bridge.ask("V") == "SONARBRIDGE 01"


class BusyHost(TwinPort):
    """A port on a computer that looks for an answer once, then sleeps over its patience."""

    naps = 0

    @property
    def in_waiting(self):
        if self.naps:
            self.naps -= 1
            there = TwinPort.in_waiting.fget(self) if not self.naps else 0
            self.clock.sleep(2.0)
            return there
        return TwinPort.in_waiting.fget(self)


def test_an_answer_that_came_in_time_counts_however_late_it_is_looked_at():
    twin, _, clock = board()
    port = BusyHost(twin, clock)
    bridge = Bridge(port, clock=clock)
    bridge.greet()
    port.naps = 2  # one look before asking, one after
    assert bridge.ask("V") == "SONARBRIDGE 01"


def test_another_version_is_refused():
    twin, bridge, _ = board()
    twin._version = lambda: (0, "SONARBRIDGE 02")
    with pytest.raises(DeviceError, match="speaks 'SONARBRIDGE 02', expected SONARBRIDGE 01; upload"):
        bridge.greet()


def test_nobody_there_is_told_after_five_seconds():
    _, bridge, clock = board(mangle=lambda due: b"")
    with pytest.raises(NoAnswerError, match="no sketch answered within 5 s"):
        bridge.greet()
    assert 5.0 <= clock() < 5.5


@pytest.mark.parametrize(
    ("fault", "message"), [(16, "high before the trigger"), (17, "did not rise"), (18, "did not fall in time")]
)
def test_an_hcsr04s_dead_lines_are_told(fault, message):
    twin, bridge, _ = greeted()
    twin.pulses.fault = fault
    with pytest.raises(NoAnswerError, match=message):
        HcSr04(bridge).ping()


def test_an_hcsr04_measures_and_is_silent():
    twin, bridge, _ = greeted()
    assert HcSr04(bridge).ping().ranges == pytest.approx((1.01,), abs=0.02)
    twin.pulses.place(Ping.of(distance=1.0, reflectance=0.0))
    twin.pulses.clock.sleep(1.0)
    assert HcSr04(bridge).ping().ranges == ()


def test_pins_are_checked():
    with pytest.raises(SettingError, match=r"echo pin must be 2 to 69 but not 20 or 21 \(I2C\), got 20"):
        HcSr04(None, echo=20)


@pytest.mark.parametrize("model", MODELS)
def test_maxbotix_families(model):
    clock = TwinClock()
    twin = ear(MaxBotixTwin, clock, model=model)
    sonar = MaxBotix(TwinPort(twin, clock), model, clock)
    assert sonar.ping().ranges == pytest.approx((1.01,), abs=0.03)
    twin.place(Ping.of(distance=1.0, reflectance=0.0))
    clock.sleep(1.0)
    assert sonar.ping().ranges == ()


def test_maxbotix_gives_no_reading_from_before():
    clock = TwinClock()
    twin = ear(MaxBotixTwin, clock)
    sonar = MaxBotix(TwinPort(twin, clock), clock=clock)
    sonar.ping()
    clock.sleep(0.5)
    twin.place(Ping.of(distance=2.0, reflectance=0.9))
    assert sonar.ping().ranges[0] == pytest.approx(2.01, abs=0.05)


def test_maxbotix_of_another_model_is_told():
    clock = TwinClock()
    port = TwinPort(ear(MaxBotixTwin, clock, model="lv"), clock)
    with pytest.raises(GarbledError, match="is not R and 4 digits; is the model right"):
        MaxBotix(port, "hrlv", clock).ping()


class TestPseudoTerminal:
    """The same with pyserial, at the host's own time."""

    def test_srf08_and_hcsr04(self, patiently):
        def attempt():
            twin = ArduinoTwin(ear(Srf08Twin, HostClock()), ear(HcSr04Twin, HostClock()))
            with PseudoTerminal(twin) as far:
                sonar = Srf08.open(far.path, gain=20, range_register=140)
                assert sonar.revision() == 10
                assert sonar.ping().ranges[0] == pytest.approx(1.01, abs=0.03)
                twin.bus.wire = BadWire(nack=1.0)
                with pytest.raises(NoAnswerError, match="no acknowledge"):
                    sonar.ping()
                sonar.bus.close()

        patiently(attempt)

    def test_unplugged(self, patiently):
        def attempt():
            with PseudoTerminal(ArduinoTwin(None, ear(HcSr04Twin, HostClock()))) as far:
                sonar = HcSr04.open(far.path)
                assert sonar.ping().ranges
                far.unplug()
                with pytest.raises(UnpluggedError, match="the port is gone"):
                    sonar.ping()
                sonar.bridge.close()

        patiently(attempt)

    def test_maxbotix(self, patiently):
        def attempt():
            with PseudoTerminal(ear(MaxBotixTwin, HostClock(), model="lv")) as far:
                sonar = MaxBotix.open(far.path, model="lv")
                assert sonar.ping().ranges == pytest.approx((1.01,), abs=0.03)
                sonar.port.close()

        patiently(attempt)

    def test_no_such_port_is_told_with_those_there_are(self):
        with pytest.raises(DeviceError, match=r"/dev/ttyNONE: .*serial ports found: .*; check the USB cable"):
            HcSr04.open("/dev/ttyNONE")
