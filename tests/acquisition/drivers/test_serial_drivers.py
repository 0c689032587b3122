"""The Arduino bridge, HC-SR04 and MaxBotix with their twins, in memory or at a pseudo-terminal (with pyserial)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
from acquisition.drivers.arduino import parse, with_checksum
from acquisition.drivers.maxbotix import MODELS
from acquisition.twins.devantech import BadWire, Srf08Twin
from acquisition.twins.simulated_sensor import TwinClock
from tests.acquisition.drivers.serial_devices import (
    ArduinoTwin,
    HcSr04Twin,
    HostClock,
    MaxBotixTwin,
    PseudoTerminal,
    TwinPort,
)

QUIET = Setup(placement_m=0.0, placement_deg=0.0, tilt_deg=0.0, drift_c=0.0, post=None)
WALL = Ping.of(distance=1.0, reflectance=0.9)


def make_twin(kind, clock, ping=WALL, **settings):
    twin = kind(Rig(Unit.nominal(), QUIET), np.random.default_rng(0), clock=clock, **settings)
    twin.place(ping)
    return twin


def board(**settings):
    """Return a simulated board with an SRF08 and an HC-SR04, its bridge, and their clock."""
    clock = TwinClock()
    twin = ArduinoTwin(make_twin(Srf08Twin, clock), make_twin(HcSr04Twin, clock), **settings)
    bridge = Bridge(TwinPort(twin, clock), clock=clock)
    return twin, bridge, clock


def greeted():
    twin, bridge, clock = board()
    bridge.handshake()
    return twin, bridge, clock


def test_checksum_is_the_published_one():
    """CRC-16/CCITT-FALSE of "123456789" is 0x29B1 in every catalogue of checksums."""
    assert with_checksum("123456789") == "123456789*29B1"


@pytest.mark.parametrize("line", [b"", b"<01 K*0000", b"01 K", b"<01 Q*FFFF", b"\xff\xfe", b"<01 K 00*12"])
def test_malformed_lines_are_garbled(line):
    with pytest.raises(GarbledError, match="garbled line"):
        parse(line)


def test_every_single_bit_error_is_detected():
    line = b"<" + with_checksum("07 K 0085").encode()
    for k in range(8 * len(line)):
        wrong = bytearray(line)
        wrong[k // 8] ^= 1 << k % 8
        with pytest.raises(GarbledError):
            parse(bytes(wrong))


def test_an_srf08_at_the_board_reads_the_same_as_on_the_bus():
    _, bridge, clock = greeted()
    sonar = Srf08(ArduinoBus(bridge), gain=20, range_register=140, sleep=clock.sleep, clock=clock)
    direct = make_twin(Srf08Twin, TwinClock())
    near = Srf08(direct, gain=20, range_register=140, sleep=direct.clock.sleep, clock=direct.clock)
    assert sonar.ping().ranges[0] == pytest.approx(near.ping().ranges[0], abs=0.02)
    assert sonar.light() == near.light()


def test_a_missing_acknowledge_at_the_board_names_sensor_and_addresses():
    _, bridge, clock = greeted()
    sonar = Srf08(ArduinoBus(bridge), address=0x75, sleep=clock.sleep, clock=clock)
    with pytest.raises(NoAnswerError, match=r"SRF08 at 0x75: no acknowledge .* found 0x70 instead"):
        sonar.ping()


def test_a_reset_is_detected_and_the_next_ping_works():
    twin, bridge, _ = greeted()
    sonar = HcSr04(bridge)
    sonar.ping()
    twin.reset()
    with pytest.raises(BoardResetError, match="restarted"):
        sonar.ping()
    assert sonar.ping().ranges


def test_answers_to_other_requests_are_an_error():
    twin, bridge, clock = greeted()
    twin.repeat = True
    began = clock()
    with pytest.raises(OutOfSequenceError, match=r"expected answer .*, got only"):
        bridge.request("V")
    assert clock() - began < 0.6


def test_a_late_answer_is_never_taken_for_the_next():
    twin, bridge, _ = greeted()
    late = []
    twin.corrupt = lambda due: late.append(due) or b""
    with pytest.raises(NoAnswerError, match="no answer within"):
        bridge.request("R 70 00 01")
    twin.corrupt = lambda due: b"".join(late) + due
    assert bridge.request("V") == "SONARBRIDGE 01"


class BusyHost(TwinPort):
    """A port on a host that checks for an answer once, then sleeps beyond the deadline."""

    naps = 0

    @property
    def in_waiting(self):
        if self.naps:
            self.naps -= 1
            available = TwinPort.in_waiting.fget(self) if not self.naps else 0
            self.clock.sleep(2.0)
            return available
        return TwinPort.in_waiting.fget(self)


def test_an_answer_that_arrived_in_time_counts_even_if_read_late():
    twin, _, clock = board()
    port = BusyHost(twin, clock)
    bridge = Bridge(port, clock=clock)
    bridge.handshake()
    port.naps = 2  # one check before the request, one after
    assert bridge.request("V") == "SONARBRIDGE 01"


def test_another_version_is_an_error():
    _, bridge, _ = board(version="SONARBRIDGE 02")
    with pytest.raises(DeviceError, match="answers 'SONARBRIDGE 02', expected SONARBRIDGE 01; upload"):
        bridge.handshake()


def test_a_missing_board_is_an_error_after_five_seconds():
    _, bridge, clock = board(corrupt=lambda due: b"")
    with pytest.raises(NoAnswerError, match="no sketch answered within 5 s"):
        bridge.handshake()
    assert 5.0 <= clock() < 5.5


@pytest.mark.parametrize(
    ("fault", "message"), [(16, "high before the trigger"), (17, "did not rise"), (18, "did not fall in time")]
)
def test_stuck_lines_of_an_hcsr04_are_errors(fault, message):
    twin, bridge, _ = greeted()
    twin.pulses.fault = fault
    with pytest.raises(NoAnswerError, match=message):
        HcSr04(bridge).ping()


def test_an_hcsr04_measures_an_echo_and_no_echo():
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
    twin = make_twin(MaxBotixTwin, clock, model=model)
    sonar = MaxBotix(TwinPort(twin, clock), model, clock)
    assert sonar.ping().ranges == pytest.approx((1.01,), abs=0.03)
    twin.place(Ping.of(distance=1.0, reflectance=0.0))
    clock.sleep(1.0)
    assert sonar.ping().ranges == ()


def test_maxbotix_discards_readings_from_before_the_ping():
    clock = TwinClock()
    twin = make_twin(MaxBotixTwin, clock)
    sonar = MaxBotix(TwinPort(twin, clock), clock=clock)
    sonar.ping()
    clock.sleep(0.5)
    twin.place(Ping.of(distance=2.0, reflectance=0.9))
    assert sonar.ping().ranges[0] == pytest.approx(2.01, abs=0.05)


@pytest.mark.parametrize("model", MODELS)
@given(clock_error=st.floats(-0.0199, 0.0299), share=st.floats(0.1, 0.9))
def test_a_pulse_of_full_width_is_silence_whatever_the_clocks(model, clock_error, share):
    family = MODELS[model]
    full_us = family.no_echo * family.pulse_us
    assert family.timed_echoes(full_us * (1.0 + clock_error), "x").ranges == ()
    distance = share * family.no_echo * family.unit_m
    assert family.timed_echoes(full_us * share, "x").ranges == pytest.approx((distance,), abs=family.unit_m)
    with pytest.raises(GarbledError, match=r"x: reads \d+, expected 1 to \d+: check the model"):
        family.timed_echoes(1.1 * full_us, "x")


def test_the_widths_and_counts_that_data_sheets_state_for_no_target_are_silence():
    for model, width_us in (("lv", 37_500), ("xl", 44_400), ("xl-long", 62_000), ("hrlv", 5_000)):
        assert MODELS[model].timed_echoes(width_us, "x").ranges == ()
    assert MODELS["lv"].echoes(255, "x").ranges == MODELS["lv"].echoes(254, "x").ranges == ()
    with pytest.raises(GarbledError, match="reads 256, expected 1 to 255"):
        MODELS["lv"].echoes(256, "x")


def test_another_maxbotix_model_is_an_error():
    clock = TwinClock()
    port = TwinPort(make_twin(MaxBotixTwin, clock, model="lv"), clock)
    with pytest.raises(GarbledError, match="is not R and 4 digits; check the model"):
        MaxBotix(port, "hrlv", clock).ping()


class TestPseudoTerminal:
    """The same with pyserial, in real time."""

    def test_srf08_and_hcsr04(self, retry):
        def attempt():
            twin = ArduinoTwin(make_twin(Srf08Twin, HostClock()), make_twin(HcSr04Twin, HostClock()))
            with PseudoTerminal(twin) as far:
                sonar = Srf08.open(far.path, gain=20, range_register=140)
                assert sonar.revision() == 10
                assert sonar.ping().ranges[0] == pytest.approx(1.01, abs=0.03)
                twin.bus.wire = BadWire(nack=1.0)
                with pytest.raises(NoAnswerError, match="no acknowledge"):
                    sonar.ping()
                sonar.bus.close()

        retry(attempt)

    def test_unplugged(self, retry):
        def attempt():
            with PseudoTerminal(ArduinoTwin(None, make_twin(HcSr04Twin, HostClock()))) as far:
                sonar = HcSr04.open(far.path)
                assert sonar.ping().ranges
                far.unplug()
                with pytest.raises(UnpluggedError, match="the port disappeared"):
                    sonar.ping()
                sonar.bridge.close()

        retry(attempt)

    def test_maxbotix(self, retry):
        def attempt():
            with PseudoTerminal(make_twin(MaxBotixTwin, HostClock(), model="lv")) as far:
                sonar = MaxBotix.open(far.path, model="lv")
                assert sonar.ping().ranges == pytest.approx((1.01,), abs=0.03)
                sonar.port.close()

        retry(attempt)

    def test_a_missing_port_is_an_error_with_the_ports_found(self):
        with pytest.raises(DeviceError, match=r"/dev/ttyNONE: .*serial ports found: .*; check the USB cable"):
            HcSr04.open("/dev/ttyNONE")


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("distance", [0.02, 0.1, 0.19, 0.29])
def test_a_maxbotix_reports_close_targets_at_its_minimum_range(model, distance):
    clock = TwinClock()
    twin = make_twin(MaxBotixTwin, clock, Ping.of(distance=distance, reflectance=0.9), model=model)
    nearest = {"lv": 6 * 0.0254, "xl": 0.2, "xl-long": 0.2, "hrlv": 0.3, "hrxl": 0.3, "hrxl-long": 0.5}[model]
    (reading,) = MaxBotix(TwinPort(twin, clock), model, clock).ping().ranges
    assert reading == pytest.approx(max(nearest, distance), abs=0.02)
