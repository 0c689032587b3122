"""An Arduino with the sketch of `acquisition/firmware` as a bridge to an I2C bus and to the pulses of an HC-SR04.

The protocol is described in docs/reference/protocols.md: one line per request and per answer, each with a sequence
number and a CRC-16/XMODEM with initial value 0xFFFF. The board reports its errors by number; the driver adds the
message.
"""

from __future__ import annotations

import binascii
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

from acquisition.drivers.serialport import READ_TIMEOUT_S, LineReader, Port, open_port
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
NO_SEQUENCE = "--"  # sequence of lines that answer no request
# for an answer; the sketch limits I2C to 25 ms, and both the wait for a pulse and the pulse to the limit in the request
PATIENCE_S = 0.5
START_S = 5.0  # for the boot loader, which runs whenever the port is opened
RETRY_S = 0.3
MAX_LATE_LINES = 8  # lines examined after the deadline, which this host read too late
LAST_PIN, I2C_PINS = 69, (20, 21)
READ_FLAG = 0x0001  # I2C_M_RD of an i2c message
NOT_ACKNOWLEDGED = {2, 3, 4, 6}
WIRE_TIMEOUT = 5
BAD_CHECKSUM = 33
BOARD_ERRORS = {
    1: "too many bytes",
    2: "address not acknowledged",
    3: "data not acknowledged",
    4: "I2C failed",
    5: "I2C held low for 25 ms",
    6: "fewer bytes than requested",
    16: "echo line high before the trigger: it is stuck; switch the sensor off and on",
    17: "echo line did not rise within 20 ms of the trigger: check 5 V, trigger and echo wires",
    18: "echo line did not fall in time: it is stuck; switch the sensor off and on",
    32: "request refused: pins 0, 1, 20, 21 are reserved, trigger and echo must differ",
    BAD_CHECKSUM: "the request arrived corrupted",
    34: "command unknown to the sketch: upload the sketch of this version",
}
LINE = re.compile(rb"<(--|[0-9A-F]{2}) ([KEB])(?: ([ -)+-~]*))?\*([0-9A-F]{4})")


def check_pin(name: str, pin: int) -> None:
    """Raise SettingError if a sensor cannot be at a pin; the name is that of the sensor and its line."""
    if not 2 <= pin <= LAST_PIN or pin in I2C_PINS:
        raise SettingError(f"{name} pin must be 2 to {LAST_PIN} but not 20 or 21 (I2C), got {pin}")


class BoardError(NoAnswerError):
    """The board reported an error; `code` is its number in `BOARD_ERRORS`."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


def with_checksum(body: str) -> str:
    """Return the body of a line with its checksum.

    >>> with_checksum("01 V")
    '01 V*6669'
    """
    return f"{body}*{binascii.crc_hqx(body.encode('ascii'), 0xFFFF):04X}"


def parse(line: bytes) -> tuple[str, str, str]:
    """Return sequence, kind (K: done, E: error, B: board started) and content of a line of the board.

    Raises:
        GarbledError: the line is malformed, or its checksum differs.
    """
    match = LINE.fullmatch(line.rstrip(b"\r"))
    if not match or binascii.crc_hqx(line[1:].rpartition(b"*")[0], 0xFFFF) != int(match[4], 16):
        raise GarbledError(f"garbled line {line[:60]!r}")
    return match[1].decode(), match[2].decode(), (match[3] or b"").decode()


@dataclass
class Bridge:
    """The board at a serial port.

    Attributes:
        port: open, at 115200 baud.
        name: for messages.
        clock: of the host, s.
        patience: longest wait for an answer, s.
    """

    port: Port
    name: str = "Arduino"
    clock: Callable[[], float] = time.monotonic
    patience: float = PATIENCE_S

    def __post_init__(self) -> None:
        """Initialise the sequence number."""
        self._lines = LineReader(self.port, self.name, clock=self.clock)
        self._sequence = 0

    @classmethod
    def open(cls, path: str) -> Bridge:
        """Open a port and check the sketch.

        Raises:
            DeviceError: the port does not exist, no board answers, or it has another sketch or version.
        """
        bridge = cls(open_port(path, BAUD), f"Arduino at {path}")
        try:
            bridge.handshake()
        except DeviceError:
            bridge.close()
            raise
        return bridge

    def pulse_us(self, request: str, sensor: str) -> int:
        """Return the duration of a pulse, us.

        Args:
            request: that the sketch answers with a duration.
            sensor: for messages.

        Raises:
            NoAnswerError: the line does not rise or does not fall in time.
            GarbledError: the answer is no duration.
        """
        answer = self.request(request)
        if not re.fullmatch("[0-9A-F]{6}", answer):
            raise GarbledError(f"{sensor}: {answer[:80]!r} is not a pulse duration; upload the current sketch")
        return int(answer, 16)

    def handshake(self) -> None:
        """Wait for the sketch, ignoring any output of a boot loader, and compare versions.

        Raises:
            NoAnswerError: the sketch does not answer within 5 s.
            DeviceError: it has another protocol version.
        """
        deadline = self.clock() + START_S
        while self.clock() < deadline:
            try:
                answer = self.request("V", patience=RETRY_S)
            except NoAnswerError:
                continue
            if answer == f"{NAME} {PROTOCOL:02X}":
                return
            raise DeviceError(
                f"{self.name}: answers {answer!r}, expected {NAME} {PROTOCOL:02X}; upload the current sketch"
            )
        raise NoAnswerError(
            f"{self.name}: no sketch answered within {START_S:g} s; upload acquisition/firmware/sonar_bridge, check "
            "the USB cable (some carry power only) and that this is the board's port"
        )

    def request(self, command: str, patience: float | None = None) -> str:
        """Send a command and return the content of its answer.

        Raises:
            BoardError: the board could not execute it.
            BoardResetError: the board restarted since the last answer and lost the state of its pins and bus.
            OutOfSequenceError: only answers to other requests arrived in time.
            GarbledError: a corrupted line arrived.
            NoAnswerError: nothing arrived in time.
            UnpluggedError: the port disappeared.
        """
        for line in self._lines.waiting():  # late answers are dropped, the message of a restart is not
            self._check_reset(line)
        self._sequence = (self._sequence + 1) % 256
        sequence = f"{self._sequence:02X}"
        self._lines.write(f">{with_checksum(f'{sequence} {command}')}\n".encode("ascii"))
        return self._answer(sequence, self.patience if patience is None else patience)

    def close(self) -> None:
        """Close the port."""
        self.port.close()

    def _answer(self, sequence: str, patience: float) -> str:
        deadline = self.clock() + patience
        others: list[str] = []
        late = 0
        while late < MAX_LATE_LINES and (line := self._lines.next(deadline)) is not None:
            late += self.clock() > deadline + READ_TIMEOUT_S
            answered, kind, content = self._parsed(line)
            if answered == NO_SEQUENCE:
                self._check_reset(line)
                raise GarbledError(f"{self.name}: {BOARD_ERRORS[BAD_CHECKSUM]}; check the USB cable")
            if answered == sequence:
                return content if kind == "K" else self._raise_board_error(content)
            others.append(answered)
        if others:
            raise OutOfSequenceError(
                f"{self.name}: expected answer {sequence}, got only {', '.join(others[:5])} within {patience:g} s; "
                "check that no other program uses the board"
            )
        raise NoAnswerError(
            f"{self.name}: no answer within {patience:g} s; check the USB cable, press the board's reset button"
        )

    def _parsed(self, line: bytes) -> tuple[str, str, str]:
        try:
            return parse(line)
        except GarbledError as error:
            raise GarbledError(f"{self.name}: {error}; check the USB cable and the baud rate, {BAUD}") from None

    def _check_reset(self, line: bytes) -> None:
        try:
            restarted = parse(line)[:2] == (NO_SEQUENCE, "B")
        except GarbledError:
            return
        if restarted:
            raise BoardResetError(f"{self.name}: the board restarted; check its power and the USB plug")

    def _raise_board_error(self, content: str) -> NoReturn:
        if not re.fullmatch(r"[0-9A-F]{2}", content):
            raise GarbledError(f"{self.name}: an error without a number, {content!r}; upload the current sketch")
        code = int(content, 16)
        raise BoardError(f"{self.name}: {BOARD_ERRORS.get(code, f'error {code}')}", code)


@dataclass
class ArduinoBus:
    """The I2C bus of a board (Mega: SDA 20, SCL 21) with the methods of `smbus2.SMBus`."""

    bridge: Bridge

    @classmethod
    def open(cls, path: str) -> ArduinoBus:
        """Open the port of a board; see `Bridge.open`."""
        return cls(Bridge.open(path))

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""
        self._request(f"W {i2c_addr:02X} {register:02X} {value:02X}")

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""
        return self._read(i2c_addr, register, 1)[0]

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Write a register pointer and read from there.

        Raises:
            SettingError: other messages, which the sketch does not support.
        """
        if len(i2c_msgs) != 2 or i2c_msgs[0].flags & READ_FLAG or not i2c_msgs[1].flags & READ_FLAG:
            raise SettingError("the bridge only reads registers: give a message that writes 1 byte and one that reads")
        pointer, answer = i2c_msgs
        for k, byte in enumerate(self._read(pointer.addr, bytes(pointer.buf[: pointer.len])[0], answer.len)):
            answer.buf[k] = bytes([byte])

    def close(self) -> None:
        """Close the port."""
        self.bridge.close()

    def _read(self, address: int, register: int, count: int) -> bytes:
        answer = self._request(f"R {address:02X} {register:02X} {count:02X}")
        if not re.fullmatch(f"[0-9A-F]{{{2 * count}}}", answer):
            raise GarbledError(
                f"{self.bridge.name}: {answer[:80]!r} is not {count} bytes in hexadecimal; upload the current sketch"
            )
        return bytes.fromhex(answer)

    def _request(self, command: str) -> str:
        """Send a request; report bus errors with the error numbers of Linux."""
        try:
            return self.bridge.request(command)
        except BoardError as error:
            if error.code in NOT_ACKNOWLEDGED:
                raise OSError(121, "Remote I/O error") from error
            if error.code == WIRE_TIMEOUT:
                raise OSError(110, "Connection timed out") from error
            raise


def opened_at(cls: type[Any], port: str, settings: dict[str, Any]) -> Any:
    """Return a sensor of an Arduino at a serial port, which is closed again where the settings are invalid."""
    bridge = Bridge.open(port)
    try:
        return cls(bridge, **settings)
    except SettingError:
        bridge.close()
        raise
