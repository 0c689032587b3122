"""Whatever bytes come over a wire: a reading that a wire can mean, or an error by name, within the stated time."""

import contextlib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition.drivers import ArduinoBus, Bridge, HcSr04, MaxBotix, Srf02, Srf08, Srf10
from acquisition.drivers.arduino import checked
from acquisition.drivers.maxbotix import MODELS
from acquisition.drivers.serialport import SLICE
from acquisition.errors import DeviceError
from acquisition.twins.simulated_sensor import TwinClock

FARTHEST_M = 12.0  # 65.5 ms of listening, and 5 %
PINGS_S = 20.0  # s of fake time for one ping with every retry, and a scan of 16 addresses, at 0.5 s an answer
LINES = st.one_of(
    st.binary(max_size=90).map(lambda b: b + b"\n"),
    st.builds(
        lambda n, kind, text: b"<" + checked(f"{n:02X} {kind}{text}").encode() + b"\n",
        st.integers(0, 9),
        st.sampled_from("KEB"),
        st.one_of(st.just(""), st.text("0123456789ABCDEF ", max_size=72).map(lambda t: " " + t)),
    ),
    st.sampled_from([b"<" + checked("-- B 01").encode() + b"\n", b"<" + checked("-- E 21").encode() + b"\n"]),
)
READINGS = st.one_of(
    st.binary(max_size=12), st.integers(0, 12000).map(lambda n: b"R%04d\r" % n), st.just(b"R123\r"), st.just(b"\r")
)


class Noise:
    """A port that gives what it is told, a chunk at a look, and then nothing, or fails."""

    def __init__(self, chunks, clock, fails):
        self.chunks, self.clock, self.fails = list(chunks), clock, fails

    @property
    def in_waiting(self):
        if not self.chunks and self.fails:
            raise OSError(5, "Input/output error")
        return len(self.chunks[0]) if self.chunks else 0

    def read(self, size=1):
        self.clock.sleep(SLICE)
        return self.chunks.pop(0) if self.chunks else b""

    def write(self, data):
        return len(data)

    def close(self):
        pass


class NoisyBus:
    """A bus that gives any byte or fails with any number."""

    def __init__(self, said, clock):
        self.said, self.clock = list(said), clock

    def _next(self):
        self.clock.sleep(1e-4)
        value = self.said.pop(0) if self.said else 10
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
    "srf08 behind an Arduino": (
        LINES,
        lambda port, clock: Srf08(ArduinoBus(Bridge(port, clock=clock)), sleep=clock.sleep, clock=clock),
        0.0,
        FARTHEST_M,
    ),
    "maxbotix": (READINGS, lambda port, clock: MaxBotix(port, clock=clock), 0.0, MODELS["hrlv"].silence * 0.001),
}


def survives(ping, clock, longest_s, farthest_m):
    began = clock()
    with contextlib.suppress(DeviceError):
        ranges = ping().ranges
        assert all(0.0 < range_ <= farthest_m for range_ in ranges)
    assert clock() - began <= longest_s


def fuzz_serial(name, cases):
    lines, make, _, farthest = SERIAL[name]

    @settings(max_examples=cases, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.lists(lines, max_size=12), st.booleans())
    def run(chunks, fails):
        clock = TwinClock()
        survives(make(Noise(chunks, clock, fails), clock).ping, clock, PINGS_S, farthest)

    run()


def fuzz_bus(kind, cases):
    said = st.one_of(st.integers(0, 0xFF), st.sampled_from([0xFF, 0xFF, 10, 0]), st.sampled_from([0x100 + 121, 0x105]))

    @settings(max_examples=cases, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.lists(said, max_size=60))
    def run(values):
        clock = TwinClock()
        sonar = kind(NoisyBus(values, clock), sleep=clock.sleep, clock=clock)
        survives(sonar.ping, clock, 0.3, FARTHEST_M)

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
