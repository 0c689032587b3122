"""The sketch compiles for the Mega and answers by the protocol on a simulated ATmega2560."""

import binascii
import ctypes
import ctypes.util
import shutil
import subprocess
from pathlib import Path

import pytest

from acquisition import NoAnswerError
from acquisition.drivers import ArduinoBus, Bridge, HcSr04, Srf08
from acquisition.drivers.arduino import parse
from acquisition.twins.serial_devices import PseudoTerminal

FIRMWARE = Path(__file__).parents[3] / "acquisition" / "firmware"
CORE = Path("/usr/share/arduino/hardware/arduino/avr/cores/arduino")
INSTALL = "apt install gcc-avr avr-libc arduino-core-avr simavr"
HERTZ = 16_000_000
BYTE = 1500  # steps for a byte to pass at 115200 baud, about 87 us
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
    """An ATmega2560 in simavr with the sketch, as a serial port; calling it returns the time of the chip."""

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
        self._notify = NOTIFY(lambda irq, value, param: self.output.append(value & 0xFF))
        lib.avr_irq_register_notify(self._irq("uar0", 1), self._notify, None)
        self._input = self._irq("uar0", 0)

    def _irq(self, name, index):
        return self.lib.avr_io_getirq(self.avr, ioctl(name), index)

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


def test_scan_of_an_empty_bus_is_empty(bridge):
    assert bridge.request("S") == ""


def test_a_sensor_without_power_does_not_raise_its_line(bridge):
    with pytest.raises(NoAnswerError, match="echo line did not rise within 20 ms"):
        HcSr04(bridge).ping()


def test_a_stuck_echo_line_is_an_error(bridge, mega):
    pin = mega._irq("iogH", 5)  # the Mega's pin 8 is port H, bit 5
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
            assert opened.request("S") == ""
            with pytest.raises(NoAnswerError, match="echo line did not rise within 20 ms"):
                HcSr04(opened).ping()
            opened.close()

    retry(attempt)
