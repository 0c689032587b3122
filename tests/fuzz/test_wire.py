"""Random bytes on a wire give a valid reading or a DeviceError, within the stated time."""

import contextlib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition.drivers import ArduinoBus, Bridge, HcSr04, MaxBotix, Srf02, Srf08, Srf10
from acquisition.drivers.arduino import with_checksum
from acquisition.drivers.maxbotix import MODELS
from acquisition.drivers.serialport import READ_TIMEOUT_S
from acquisition.errors import DeviceError
from acquisition.twins.simulated_sensor import TwinClock

MAX_RANGE_M = 12.0  # 65.5 ms of listening, and 5 %
MAX_PING_S = 20.0  # simulated time of one ping with all retries and a scan of 16 addresses, at 0.5 s per answer
LINES = st.one_of(
    st.binary(max_size=90).map(lambda b: b + b"\n"),
    st.builds(
        lambda n, kind, text: b"<" + with_checksum(f"{n:02X} {kind}{text}").encode() + b"\n",
        st.integers(0, 9),
        st.sampled_from("KEB"),
        st.one_of(st.just(""), st.text("0123456789ABCDEF ", max_size=72).map(lambda t: " " + t)),
    ),
    st.sampled_from(
        [b"<" + with_checksum("-- B 01").encode() + b"\n", b"<" + with_checksum("-- E 21").encode() + b"\n"]
    ),
)
READINGS = st.one_of(
    st.binary(max_size=12), st.integers(0, 12000).map(lambda n: b"R%04d\r" % n), st.just(b"R123\r"), st.just(b"\r")
)


class RandomPort:
    """A port that returns prepared chunks, one per read, and then nothing or an error."""

    def __init__(self, chunks, clock, fails):
        self.chunks, self.clock, self.fails = list(chunks), clock, fails

    @property
    def in_waiting(self):
        if not self.chunks and self.fails:
            raise OSError(5, "Input/output error")
        return len(self.chunks[0]) if self.chunks else 0

    def read(self, size=1):
        self.clock.sleep(READ_TIMEOUT_S)
        return self.chunks.pop(0) if self.chunks else b""

    def write(self, data):
        return len(data)

    def close(self):
        pass


class RandomBus:
    """A bus that returns any byte or fails with any error number."""

    def __init__(self, values, clock):
        self.values, self.clock = list(values), clock

    def _next(self):
        self.clock.sleep(1e-4)
        value = self.values.pop(0) if self.values else 10
        if value > 0xFF:
            raise OSError(value - 0x100, "made up")
        return value

    def write_byte_data(self, i2c_addr, register, value):
        self._next()

    def read_byte_data(self, i2c_addr, register):
        return self._next()

    def i2c_rdwr(self, *messages):
        for k in range(messages[1].len):
            messages[1].buf[k] = bytes([self._next()])

    def close(self):
        pass


SERIAL = {
    "hcsr04": (LINES, lambda port, clock: HcSr04(Bridge(port, clock=clock)), 0.0, 300.0),
    "srf08 at an Arduino": (
        LINES,
        lambda port, clock: Srf08(ArduinoBus(Bridge(port, clock=clock)), sleep=clock.sleep, clock=clock),
        0.0,
        MAX_RANGE_M,
    ),
    "maxbotix": (READINGS, lambda port, clock: MaxBotix(port, clock=clock), 0.0, MODELS["hrlv"].no_echo * 0.001),
}


def check_ping(ping, clock, max_s, max_range_m):
    began = clock()
    with contextlib.suppress(DeviceError):
        ranges = ping().ranges
        assert all(0.0 < range_ <= max_range_m for range_ in ranges)
    assert clock() - began <= max_s


def fuzz_serial(name, cases):
    lines, make, _, max_range_m = SERIAL[name]

    @settings(max_examples=cases, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.lists(lines, max_size=12), st.booleans())
    def run(chunks, fails):
        clock = TwinClock()
        check_ping(make(RandomPort(chunks, clock, fails), clock).ping, clock, MAX_PING_S, max_range_m)

    run()


def fuzz_bus(kind, cases):
    answers = st.one_of(
        st.integers(0, 0xFF), st.sampled_from([0xFF, 0xFF, 10, 0]), st.sampled_from([0x100 + 121, 0x105])
    )

    @settings(max_examples=cases, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.lists(answers, max_size=60))
    def run(values):
        clock = TwinClock()
        sonar = kind(RandomBus(values, clock), sleep=clock.sleep, clock=clock)
        check_ping(sonar.ping, clock, 0.3, MAX_RANGE_M)

    run()


@pytest.mark.parametrize("name", SERIAL)
def test_serial_bytes(name):
    fuzz_serial(name, 200)


@pytest.mark.parametrize("kind", [Srf08, Srf10, Srf02])
def test_bus_bytes(kind):
    fuzz_bus(kind, 200)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", SERIAL)
def test_serial_bytes_ten_thousand_times(name):
    fuzz_serial(name, 10_000)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("kind", [Srf08, Srf10, Srf02])
def test_bus_bytes_ten_thousand_times(kind):
    fuzz_bus(kind, 10_000)
