"""An Arduino with the sketch of `acquisition/firmware` as a bridge: its I2C bus, and pulses of an HC-SR04.

The protocol is in docs/drivers.md: one request, one answer, each a line with a sequence number and a CRC-16/XMODEM
begun at 0xFFFF. What the board could not do is an answer with a number; what it did not say is an error here.
"""

from __future__ import annotations

import binascii
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

from acquisition.drivers.serialport import SLICE, Lines, Port, open_port
from acquisition.errors import (
    BoardResetError,
    DeviceError,
    GarbledError,
    NoAnswerError,
    OutOfSequenceError,
    SettingError,
)

BAUD = 115200
PROTOCOL = 1
NAME = "SONARBRIDGE"
NOBODY = "--"  # sequence of lines that answer no request
PATIENCE = 0.5  # s for an answer; the sketch's own limits are 25 ms on I2C and given with each pulse
START = 5.0  # s for the boot loader, which runs whenever the port is opened
ASK_AGAIN = 0.3  # s
LATE_LINES = 8  # looked at after patience has ended, where this computer was busy elsewhere when they came
READ_FLAG = 0x0001  # I2C_M_RD of an i2c message
NOT_ACKNOWLEDGED = {2, 3, 4, 6}
WIRE_TIMEOUT = 5
TROUBLES = {
    1: "too many bytes",
    2: "address not acknowledged",
    3: "data not acknowledged",
    4: "I2C failed",
    5: "I2C held low for 25 ms",
    6: "fewer bytes than asked for",
    16: "echo line high before the trigger: it is stuck; power the sensor off and on",
    17: "echo line did not rise within 20 ms of the trigger: check 5 V, trigger and echo wires",
    18: "echo line did not fall in time: it is stuck; power the sensor off and on",
    32: "request refused: pins 0, 1, 20, 21 are taken, trigger and echo must differ",
    33: "request came garbled",
    34: "command unknown to the sketch: upload the sketch of this version",
}
LINE = re.compile(rb"<(--|[0-9A-F]{2}) ([KEB])(?: ([ -)+-~]*))?\*([0-9A-F]{4})")


class TroubleError(NoAnswerError):
    """The board answered that it could not; `code` says why."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


def checked(body: str) -> str:
    """Return a line's body with its checksum.

    >>> checked("01 V")
    '01 V*6669'
    """
    return f"{body}*{binascii.crc_hqx(body.encode('ascii'), 0xFFFF):04X}"


def parse(line: bytes) -> tuple[str, str, str]:
    """Return sequence, kind (K done, E trouble, B begun) and content of a line of the board.

    Raises:
        GarbledError: the line is no such line, or its checksum differs.
    """
    match = LINE.fullmatch(line.rstrip(b"\r"))
    if not match or binascii.crc_hqx(line[1:].rpartition(b"*")[0], 0xFFFF) != int(match[4], 16):
        raise GarbledError(f"garbled line {line[:60]!r}")
    return match[1].decode(), match[2].decode(), (match[3] or b"").decode()


@dataclass
class Bridge:
    """The board at the other end of a serial port.

    Attributes:
        port: open, at 115200 baud.
        name: what messages call it.
        clock: of the host.
        patience: s to wait for an answer.
    """

    port: Port
    name: str = "Arduino"
    clock: Callable[[], float] = time.monotonic
    patience: float = PATIENCE

    def __post_init__(self) -> None:
        """Begin to count."""
        self._lines = Lines(self.port, self.name, clock=self.clock)
        self._sequence = 0

    @classmethod
    def open(cls, path: str) -> Bridge:
        """Open a port and shake hands.

        Raises:
            DeviceError: no such port, nobody there, or another sketch or version.
        """
        bridge = cls(open_port(path, BAUD), f"Arduino at {path}")
        try:
            bridge.greet()
        except DeviceError:
            bridge.close()
            raise
        return bridge

    def greet(self) -> None:
        """Await the sketch, however much a boot loader says first, and compare versions.

        Raises:
            NoAnswerError: no sketch of ours answers within 5 s.
            DeviceError: it speaks another version.
        """
        deadline = self.clock() + START
        while self.clock() < deadline:
            try:
                said = self.ask("V", patience=ASK_AGAIN)
            except NoAnswerError:
                continue
            if said == f"{NAME} {PROTOCOL:02X}":
                return
            raise DeviceError(f"{self.name}: speaks {said!r}, expected {NAME} {PROTOCOL:02X}; upload the sketch anew")
        raise NoAnswerError(
            f"{self.name}: no sketch answered within {START:g} s; upload acquisition/firmware/sonar_bridge, check the "
            "USB cable (some carry power only) and that this is the board's port"
        )

    def ask(self, command: str, patience: float | None = None) -> str:
        """Send a command and return the content of its answer.

        Raises:
            TroubleError: the board could not do it.
            BoardResetError: the board started anew since the last answer; its pins and bus did, too.
            OutOfSequenceError, GarbledError, NoAnswerError: no answer came in time, but others, garbage, nothing.
            UnpluggedError: the port is gone.
        """
        for line in self._lines.waiting():  # late answers are of no use, a board that begins is
            self._notice_reset(line)
        self._sequence = (self._sequence + 1) % 256
        sequence = f"{self._sequence:02X}"
        self._lines.write(f">{checked(f'{sequence} {command}')}\n".encode("ascii"))
        return self._answer(sequence, self.patience if patience is None else patience)

    def close(self) -> None:
        """Let go of the port."""
        self.port.close()

    def _answer(self, sequence: str, patience: float) -> str:
        deadline = self.clock() + patience
        others: list[str] = []
        late = 0
        while late < LATE_LINES and (line := self._lines.next(deadline)) is not None:
            late += self.clock() > deadline + SLICE
            said, kind, content = self._parsed(line)
            if said == NOBODY:
                self._notice_reset(line)
                raise GarbledError(f"{self.name}: {TROUBLES[33]}; check the USB cable")
            if said == sequence:
                return content if kind == "K" else self._trouble(content)
            others.append(said)
        if others:
            raise OutOfSequenceError(
                f"{self.name}: awaited answer {sequence}, got only {', '.join(others[:5])} within {patience:g} s; "
                "dropped them: is another program talking to the board?"
            )
        raise NoAnswerError(f"{self.name}: no answer within {patience:g} s; check the USB cable, press its reset key")

    def _parsed(self, line: bytes) -> tuple[str, str, str]:
        try:
            return parse(line)
        except GarbledError as error:
            raise GarbledError(f"{self.name}: {error}; check the USB cable and the baud rate, {BAUD}") from None

    def _notice_reset(self, line: bytes) -> None:
        try:
            began = parse(line)[:2] == (NOBODY, "B")
        except GarbledError:
            return
        if began:
            raise BoardResetError(f"{self.name}: the board started anew; check its power (a loose USB plug?)")

    def _trouble(self, content: str) -> NoReturn:
        if not re.fullmatch(r"[0-9A-F]{2}", content):
            raise GarbledError(f"{self.name}: a trouble without its number, {content!r}; upload the sketch anew")
        code = int(content, 16)
        raise TroubleError(f"{self.name}: {TROUBLES.get(code, f'trouble {code}')}", code)


@dataclass
class ArduinoBus:
    """The I2C bus of a board (Mega: SDA 20, SCL 21), in the shape of `smbus2.SMBus`."""

    bridge: Bridge

    @classmethod
    def open(cls, path: str) -> ArduinoBus:
        """Open a board's port; see `Bridge.open`."""
        return cls(Bridge.open(path))

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""
        self._ask(f"W {i2c_addr:02X} {register:02X} {value:02X}")

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""
        return self._read(i2c_addr, register, 1)[0]

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Run a register pointer and the read that follows it.

        Raises:
            SettingError: other messages; the sketch knows these only.
        """
        if len(i2c_msgs) != 2 or i2c_msgs[0].flags & READ_FLAG or not i2c_msgs[1].flags & READ_FLAG:
            raise SettingError("the bridge reads registers only: give a message that writes 1 byte and one that reads")
        pointer, answer = i2c_msgs
        for k, byte in enumerate(self._read(pointer.addr, bytes(pointer.buf[: pointer.len])[0], answer.len)):
            answer.buf[k] = bytes([byte])

    def close(self) -> None:
        """Let go of the port."""
        self.bridge.close()

    def _read(self, address: int, register: int, count: int) -> bytes:
        said = self._ask(f"R {address:02X} {register:02X} {count:02X}")
        if not re.fullmatch(f"[0-9A-F]{{{2 * count}}}", said):
            raise GarbledError(f"{self.bridge.name}: {said[:80]!r} are not {count} bytes; upload the sketch anew")
        return bytes.fromhex(said)

    def _ask(self, command: str) -> str:
        """Ask, and tell a missing acknowledge as Linux does."""
        try:
            return self.bridge.ask(command)
        except TroubleError as error:
            if error.code in NOT_ACKNOWLEDGED:
                raise OSError(121, "Remote I/O error") from error
            if error.code == WIRE_TIMEOUT:
                raise OSError(110, "Connection timed out") from error
            raise
