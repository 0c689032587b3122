"""The sketch compiles for the Mega and answers by the protocol on a simulated ATmega2560."""

import binascii
import ctypes
import ctypes.util
import gc
import shutil
import subprocess
import weakref
from functools import partial
from pathlib import Path

import pytest

from acquisition import NoAnswerError
from acquisition.drivers import ArduinoBus, Bridge, HcSr04, MaxBotixPwm, Srf08
from acquisition.drivers.arduino import parse
from tests.acquisition.drivers.serial_devices import PseudoTerminal

FIRMWARE = Path(__file__).parents[3] / "acquisition" / "firmware"
CORE = Path("/usr/share/arduino/hardware/arduino/avr/cores/arduino")
INSTALL = "apt install gcc-avr avr-libc arduino-core-avr simavr"
HERTZ = 16_000_000
BYTE = 1500  # steps for a byte to pass at 115200 baud, about 87 us
TIMER = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_void_p)
START, STOP, ACKNOWLEDGE, WRITE, READ = 1, 2, 8, 16, 32  # conditions of the bus in simavr's avr_twi.h
NOTIFY = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_void_p)


@pytest.fixture(scope="module")
def elf(tmp_path_factory):
    if not (shutil.which("avr-g++") and shutil.which("make") and CORE.is_dir()):
        pytest.skip(f"no AVR toolchain with the Arduino core: {INSTALL}")
    build = tmp_path_factory.mktemp("firmware")
    done = subprocess.run(
        ["make", "-s", "-C", FIRMWARE, f"BUILD={build}"], capture_output=True, text=True, check=False, timeout=200
    )
    assert done.returncode == 0, done.stderr
    assert "sonar_bridge.ino" not in done.stderr, f"the sketch gives warnings: {done.stderr}"
    return build / "sonar_bridge.elf"


def ioctl(text):
    return int.from_bytes(text.encode(), "big")


class Mega:
    """An ATmega2560 in simavr with the sketch, as a serial port; calling it returns the time of the chip.

    It owns what C may call, and so whatever is connected to it, since simavr keeps the pointers.
    """

    def __init__(self, library, elf):
        self.lib = lib = ctypes.CDLL(library)
        lib.avr_make_mcu_by_name.restype = lib.avr_io_getirq.restype = ctypes.c_void_p
        lib.avr_io_getirq.argtypes = [ctypes.c_void_p, ctypes.c_uint32, ctypes.c_int]
        for name in ("avr_init", "avr_run"):
            getattr(lib, name).argtypes = [ctypes.c_void_p]
        lib.avr_load_firmware.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
        lib.avr_raise_irq.argtypes = [ctypes.c_void_p, ctypes.c_uint32]
        lib.avr_ioctl.argtypes = [ctypes.c_void_p, ctypes.c_uint32, ctypes.c_void_p]
        lib.avr_irq_register_notify.argtypes = [ctypes.c_void_p, NOTIFY, ctypes.c_void_p]
        lib.avr_cycle_timer_register_usec.argtypes = [ctypes.c_void_p, ctypes.c_uint32, TIMER, ctypes.c_void_p]
        lib.elf_read_firmware.argtypes = [ctypes.c_char_p, ctypes.c_void_p]
        firmware = ctypes.create_string_buffer(1 << 20)  # more than an elf_firmware_t, which begins with name and Hz
        assert lib.elf_read_firmware(str(elf).encode(), firmware) == 0
        ctypes.memmove(firmware, b"atmega2560\0", 11)
        ctypes.c_uint32.from_buffer(firmware, 64).value = HERTZ
        self.avr = lib.avr_make_mcu_by_name(b"atmega2560")
        lib.avr_init(self.avr)
        lib.avr_load_firmware(self.avr, firmware)
        lib.avr_ioctl(self.avr, ioctl("uas0"), ctypes.byref(ctypes.c_uint32(0)))  # no copy on stdout, no sleeping
        self.output = bytearray()
        self.steps = 0
        self._owned = [firmware]
        self.on(self.irq("uar0", 1), lambda value: self.output.append(value & 0xFF))
        self._input = self.irq("uar0", 0)

    def irq(self, name, index):
        """Return a signal."""
        return self.lib.avr_io_getirq(self.avr, ioctl(name), index)

    def on(self, irq, function):
        """Call a function with each value of a signal from now on."""
        self._owned.append(NOTIFY(lambda irq, value, param: function(value)))
        self.lib.avr_irq_register_notify(irq, self._owned[-1], None)

    def after(self, microseconds, function):
        """Call a function once, after a time of the chip."""
        self._owned.append(TIMER(lambda avr, when, param: function() or 0))
        self.lib.avr_cycle_timer_register_usec(self.avr, microseconds, self._owned[-1], None)

    def run(self, steps):
        for _ in range(steps):
            self.lib.avr_run(self.avr)
        self.steps += steps

    def __call__(self):
        """Return the time, s: most instructions take one or two cycles."""
        return self.steps * 1.5 / HERTZ

    @property
    def in_waiting(self):
        return len(self.output)

    def read(self, size=1):
        if not self.output:
            self.run(20_000)
        given = bytes(self.output[:size])
        del self.output[:size]
        return given

    def write(self, data):
        for byte in data:
            self.lib.avr_raise_irq(self._input, byte)
            self.run(BYTE)
        return len(data)

    def close(self):
        pass


class Sonar:
    """A device at the chip's I2C pins, with registers and a pointer, as simavr's example i2ctest has them.

    Attributes:
        address: 7-bit.
        registers: 256 bytes.
        busy: number of further addressings that are not acknowledged.
        writes: bytes of each write transaction.
    """

    def __init__(self, mega, address):
        self.mega, self.address, self.registers = mega, address, bytearray((7 * k + 3) % 256 for k in range(256))
        self.busy, self.writes, self.pointer, self._selected = 0, [], 0, False
        mega.on(mega.irq("twi\0", 1), self._on_bus)
        self._input = mega.irq("twi\0", 0)

    def _on_bus(self, value):
        message, addressed, data = value >> 8 & 0xFF, value >> 16 & 0xFF, value >> 24 & 0xFF
        if message & STOP:
            self._selected = False
        if message & START:
            self._selected = addressed >> 1 == self.address and not self.busy
            self.busy -= bool(self.busy and addressed >> 1 == self.address)
            if self._selected:
                self._answer(ACKNOWLEDGE, addressed, 1)
                if not addressed & 1:
                    self.writes.append([])
        if self._selected and message & WRITE:
            self._answer(ACKNOWLEDGE, addressed, 1)
            if not self.writes[-1]:
                self.pointer = data
            self.writes[-1].append(data)
        if self._selected and message & READ:
            self._answer(READ, addressed, self.registers[self.pointer])
            self.pointer = (self.pointer + 1) % 256

    def _answer(self, message, address, data):
        self.mega.lib.avr_raise_irq(self._input, message << 8 | address << 16 | data << 24)


class EchoLine:
    """An HC-SR04 at pins 9 and 8, port H bits 6 and 5: after each trigger, a pulse of `width_us`; none for 0."""

    def __init__(self, mega, delay_us=450):
        self.mega, self.delay_us, self.width_us, self._high = mega, delay_us, 0, False
        self._echo = mega.irq("iogH", 5)
        mega.on(mega.irq("iogH", 6), self._on_trigger)

    def _on_trigger(self, value):
        if self._high and not value and self.width_us:
            for level, after_us in ((1, self.delay_us), (0, self.delay_us + self.width_us)):
                self.mega.after(after_us, partial(self.mega.lib.avr_raise_irq, self._echo, level))
        self._high = bool(value)


class PulseTrain:
    """The PW output of a MaxBotix at pin 8: pulses of `width_us` by itself, one every `period_us`."""

    def __init__(self, mega, width_us, period_us=49_000):
        self.mega, self.on = mega, True
        self._level, self._next = 0, (period_us - width_us, width_us)
        self._pin = mega.irq("iogH", 5)
        mega.after(period_us, self._toggle)

    def _toggle(self):
        self._level = int(self.on) and 1 - self._level
        self.mega.lib.avr_raise_irq(self._pin, self._level)
        if self.on:
            self.mega.after(self._next[self._level], self._toggle)


class OnCable:
    """The chip as a device at a serial line, which also runs without input."""

    def __init__(self, mega):
        self.mega = mega

    def feed(self, data):
        self.mega.write(data)
        self.mega.run(20_000)
        due = bytes(self.mega.output)
        self.mega.output.clear()
        return due


@pytest.fixture(scope="module")
def mega(elf):
    library = ctypes.util.find_library("simavr") or "libsimavr.so.2"
    try:
        return Mega(library, elf)
    except OSError:
        pytest.skip(f"no simavr: {INSTALL}")


@pytest.fixture(scope="module")
def bridge(mega):
    bridge = Bridge(mega, "simulated Mega", clock=mega)
    mega.run(400_000)
    assert parse(mega.output.split(b"\n")[0]) == ("--", "B", "01")
    mega.output.clear()
    bridge.handshake()
    return bridge


def test_it_compiles_and_fits(elf):
    sizes = subprocess.run(["avr-size", elf], capture_output=True, text=True, check=True).stdout.split("\n")[1].split()
    text, data, bss = map(int, sizes[:3])
    assert text + data < 32_256  # an Uno's flash
    assert data + bss < 1_536  # of an Uno's 2048 bytes, a quarter left for the stack


def test_an_empty_bus_gives_no_acknowledge(bridge, mega):
    sonar = Srf08(ArduinoBus(bridge), sleep=lambda s: None, clock=mega)
    with pytest.raises(NoAnswerError, match="SRF08 at 0x70: no acknowledge in 3 tries"):
        sonar.ping()


def test_a_sensor_without_power_does_not_raise_its_line(bridge):
    with pytest.raises(NoAnswerError, match="echo line did not rise within 20 ms"):
        HcSr04(bridge).ping()


def test_a_stuck_echo_line_is_an_error(bridge, mega):
    pin = mega.irq("iogH", 5)  # the Mega's pin 8 is port H, bit 5
    mega.lib.avr_raise_irq(pin, 1)
    with pytest.raises(NoAnswerError, match="high before the trigger"):
        HcSr04(bridge).ping()
    mega.lib.avr_raise_irq(pin, 0)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("X", "unknown to the sketch"),
        ("W 70", "request refused"),
        ("R 70 00 25", "request refused"),
        ("R 170 0 1", "request refused"),
        ("D 1 2 1000", "request refused"),
        ("D 14 8 1000", "request refused"),
        ("W 70" + " 00" * 17, "request refused"),
    ],
)
def test_invalid_requests_are_refused(bridge, command, message):
    with pytest.raises(NoAnswerError, match=message):
        bridge.request(command)


@pytest.mark.parametrize("line", [b">01 V*0000\n", b"\xff\x00\n", b">\n", b">01 V\n", b"A" * 300 + b"\n"])
def test_garbage_is_answered_as_such_and_has_no_later_effect(bridge, mega, line):
    mega.write(line)
    mega.run(100_000)
    assert parse(mega.output.split(b"\n")[0]) == ("--", "E", "21")
    mega.output.clear()
    assert bridge.request("V") == "SONARBRIDGE 01"


def test_checksums_of_sketch_and_host_agree(mega):
    body = b"C3 V"
    mega.write(b">%s*%04X\n" % (body, binascii.crc_hqx(body, 0xFFFF)))
    mega.run(100_000)
    assert parse(bytes(mega.output).rstrip(b"\n")) == ("C3", "K", "SONARBRIDGE 01")
    mega.output.clear()


def test_pyserial_communicates_with_the_compiled_sketch_at_a_pseudo_terminal(bridge, mega, retry):
    def attempt():
        with PseudoTerminal(OnCable(mega)) as far:
            opened = Bridge.open(far.path)
            opened.patience = 10.0  # the simulated chip is slower than a real one
            assert opened.request("V") == "SONARBRIDGE 01"
            with pytest.raises(NoAnswerError, match="echo line did not rise within 20 ms"):
                HcSr04(opened).ping()
            opened.close()

    retry(attempt)


@pytest.fixture(scope="module")
def sonar(bridge, mega):
    return Sonar(mega, 0x70)


def test_a_device_on_the_bus_is_written_and_read(bridge, sonar):
    sonar.writes.clear()
    assert bridge.request("W 70 00 51") == ""
    assert [each for each in sonar.writes if each] == [[0x00, 0x51]]
    expected = "".join(f"{value:02X}" for value in sonar.registers[2:36])
    assert bridge.request("R 70 02 22") == expected  # in two parts, since the Wire library has a buffer of 32 bytes


def test_the_driver_tries_a_busy_sensor_again(bridge, sonar, mega):
    bus = ArduinoBus(bridge)
    sonar.busy = 2
    assert Srf08(bus, sleep=lambda s: None, clock=mega).revision() == sonar.registers[0]
    sonar.busy = 3
    with pytest.raises(NoAnswerError, match="no acknowledge in 3 tries"):
        Srf08(bus, sleep=lambda s: None, clock=mega).revision()
    sonar.busy = 0


@pytest.mark.parametrize("width_us", [116, 580, 5800, 23_200])
def test_the_chip_times_an_echo_to_a_few_microseconds(bridge, mega, width_us):
    line = EchoLine(mega)
    line.width_us = width_us
    (reading,) = HcSr04(bridge).ping().ranges
    assert reading * 58.0 / 0.01 == pytest.approx(width_us, abs=12)
    line.width_us = 0
    with pytest.raises(NoAnswerError, match="echo line did not rise within 20 ms"):
        HcSr04(bridge).ping()


def test_what_is_connected_to_the_chip_lives_as_long_as_the_chip(bridge, mega):
    line, train = weakref.ref(EchoLine(mega)), weakref.ref(PulseTrain(mega, 580))
    train().on = False
    gc.collect()
    assert line() is not None
    with pytest.raises(NoAnswerError, match="echo line did not rise within 20 ms"):
        HcSr04(bridge).ping()  # its trigger is a signal that the line receives
    assert train() is not None


@pytest.mark.parametrize("count", [20, 100, 700])
def test_the_chip_times_a_whole_pulse_of_a_sensor_that_pulses_by_itself(bridge, mega, count):
    train = PulseTrain(mega, 58 * count)
    mega.run(500_000)  # into the train, so that the first pulse seen may already be under way
    for _ in range(2):
        assert MaxBotixPwm(bridge, "xl").ping().ranges == (0.01 * count,)
    train.on = False
    with pytest.raises(NoAnswerError):
        MaxBotixPwm(bridge, "xl").ping()
