"""The sketch compiled for the host, with a simulated I2C bus, echo line and clock instead of the Arduino core."""

import binascii
import ctypes
import shutil
import subprocess
from pathlib import Path

HERE = Path(__file__).parent
SKETCH = HERE.parents[2] / "acquisition" / "firmware" / "sonar_bridge" / "sonar_bridge.ino"
LIBRARY = "SONAR_GYM_SKETCH"  # environment variable: a compiled sketch to test instead of the one of the project
TRIGGER, ECHO = 9, 8
FINE, DATA_NACK, STUCK, SHORT = range(4)
_copies = iter(range(1_000_000))


def compile_sketch(source, out, *flags):
    """Compile a sketch as a shared library; return whether it compiles.

    Args:
        source: text.
        out: path of the library.
        flags: further ones of g++.
    """
    include = HERE / "host"
    command = ["g++", "-shared", "-fPIC", "-O0", "-std=gnu++17", f"-I{include}", "-x", "c++", "-", "-o", out, *flags]
    source = source.replace("unsigned long", "uint32_t")  # of 32 bits on the board
    done = subprocess.run(command, input=source, text=True, capture_output=True, check=False, timeout=60)
    return done.returncode == 0


def framed(body):
    """Return a request line."""
    return f">{body}*{binascii.crc_hqx(body.encode(), 0xFFFF):04X}\n".encode()


class Board:
    """A board that has just been switched on: a copy of the library, since a sketch has static variables."""

    def __init__(self, library, folder):
        copy = shutil.copy(library, folder / f"board{next(_copies)}.so")
        self.lib = ctypes.CDLL(str(copy))
        for name in ("host_time", "host_trigger_low", "host_trigger_high"):
            getattr(self.lib, name).restype = ctypes.c_int64
        self.lib.host_set_echo.argtypes = [ctypes.c_int] * 3 + [ctypes.c_uint64] * 2
        self.lib.host_set_pulses.argtypes = [ctypes.c_int, ctypes.c_uint64, ctypes.c_uint64]
        self.lib.host_set_time.argtypes = [ctypes.c_uint64]
        self.lib.host_baud.restype = ctypes.c_ulong
        self.lib.host_setup()
        self.greeting = self.take()

    def take(self):
        """Return what the board has sent."""
        return self._text(self.lib.host_take)

    def feed(self, data):
        """Send bytes; return the answer."""
        self.lib.host_feed(data, len(data))
        return self.take()

    def ask(self, body):
        """Send a request; return the text of its answer, whose frame and checksum are checked."""
        return unframed(self.feed(framed(body)))

    def writes(self):
        """Return the write transactions since the last call: address, then bytes."""
        log, out = self._text(self.lib.host_log), []
        while log:
            address, n = log[:2]
            out.append((address, list(log[2 : 2 + n])))
            log = log[2 + n :]
        return out

    def _text(self, function):
        into = ctypes.create_string_buffer(100_000)
        n = function(into)
        return into.raw[:n]


def unframed(line):
    """Return the body of one line of the board."""
    assert line[:1] == b"<", line
    assert line[-1:] == b"\n", line
    assert line.count(b"\n") == 1, line
    body, _, crc = line[1:-1].rpartition(b"*")
    assert crc == f"{binascii.crc_hqx(body, 0xFFFF):04X}".encode(), line
    return body.decode()
