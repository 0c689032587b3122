"""Twins of the Devantech sonars, with the methods of `smbus2.SMBus`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from acquisition.bench.acoustics.receiver import GAINS
from acquisition.bench.laboratory.setup import Output
from acquisition.drivers.devantech import COMMAND, GAIN, RANGE, RANGING, STEP_S, UNLOCK
from acquisition.drivers.srf08 import ANN
from acquisition.twins.simulated_sensor import SimulatedSensor, TwinClock

__all__ = ["BadWire", "Srf02Twin", "Srf08Twin", "Srf10Twin", "TwinClock"]

REVISION = 10
SRF02_MIN_RANGE_CM, SRF10_MIN_RANGE_CM = 16, 6  # Devantech; the only transducer of an SRF02 rings until then
NACK = 121  # EREMOTEIO
READ_FLAG = 0x0001  # I2C_M_RD of an i2c message
GENERAL_CALL = 0
READ_OUT_S = 1e-3  # from the end of listening until the sensor answers again
GATE_US = 2048
OUTPUTS = {code: output for output, code in RANGING.items()}
COUNT_US: dict[Output, float] = {"inch": 148.0, "cm": 58.0, "us": 1.0}  # us per count
ANN_COUNT_US = {code: COUNT_US[output] for output, code in ANN.items()}
SRF10_GAINS = (40, 40, 50, 60, 70, 80, 100, 120, 140, 200, 250, 300, 350, 400, 500, 600, 700)


@dataclass
class BadWire:
    """Faults of the wire.

    Attributes:
        nack: probability that a transfer is not acknowledged.
        lost_write: probability that a write is acknowledged but lost.
        stuck: all reads return 0xFF.
    """

    nack: float = 0.0
    lost_write: float = 0.0
    stuck: bool = False


@dataclass
class Srf08Twin(SimulatedSensor):
    """A simulated SRF08.

    Attributes:
        address: 7-bit.
        wire: faults of the wire.
        busy_reads_ones: a busy sensor reads 0xFF instead of not acknowledging.
    """

    address: int = 0x70
    wire: BadWire = field(default_factory=BadWire)
    busy_reads_ones: bool = False
    full_gain: ClassVar[int] = 31
    min_range_cm: ClassVar[int] = 0  # echoes from closer are not registered; the rig simulates that of an SRF08

    def __post_init__(self) -> None:
        """Switch on."""
        super().__post_init__()
        self.power_cycle()

    def power_cycle(self) -> None:
        """Reset what the sensor holds in RAM: gain, range, echoes, and a ping under way."""
        self.gain, self.range_register = self.full_gain, 255
        self._ready, self._echoes = 0.0, bytes(34)
        self._unlocking: list[int] = []
        self._output: Output = "cm"  # of the last ranging

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write register 0, 1 or 2."""
        self._transfer(i2c_addr, write=True)
        if self.rng.random() < self.wire.lost_write:
            return
        if register == GAIN:
            self.gain = value
        elif register == RANGE:
            self.range_register = value
        elif register == COMMAND:
            self._command(value)

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Return one register."""
        return self._read(i2c_addr, register, 1)[0]

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Write a register pointer and read from there."""
        pointer = 0
        for message in i2c_msgs:
            if message.flags & READ_FLAG:
                for k, byte in enumerate(self._read(message.addr, pointer, message.len)):
                    message.buf[k] = bytes([byte])
            else:
                self._transfer(message.addr, write=True)
                pointer = bytes(message.buf[: message.len])[0]

    def close(self) -> None:
        """Do nothing: there is no file to close."""

    def registers(self) -> bytes:
        """Return the readable registers from register 0 on."""
        return bytes([REVISION, self.rig.unit.light]) + self._echoes

    def settings(self) -> tuple[int, int]:
        """Return gain code of the rig and range register.

        Gain codes above 31 are undocumented; the twin uses the lowest five bits.
        """
        return self.gain & 31, self.range_register

    def _transfer(self, address: int, write: bool) -> None:
        """Raise OSError unless the sensor acknowledges the transfer."""
        addressed = address == self.address or (write and address == GENERAL_CALL)
        busy = self.clock() < self._ready and (write or not self.busy_reads_ones)
        if not addressed or busy or self.rng.random() < self.wire.nack:
            raise OSError(NACK, "Remote I/O error")

    def _read(self, address: int, register: int, count: int) -> bytes:
        self._transfer(address, write=False)
        if self.wire.stuck or self.clock() < self._ready:
            return b"\xff" * count
        return self.registers()[register : register + count].ljust(count, b"\xff")

    def _command(self, value: int) -> None:
        self._unlocking = [*self._unlocking, value][-4:]
        if tuple(self._unlocking[:3]) == UNLOCK and value % 2 == 0 and 0xE0 <= value <= 0xFE:
            self.address = value >> 1
        if value in OUTPUTS:
            self._output, (gain, reach) = OUTPUTS[value], self.settings()
            codes = self.fire(self._output, gain, reach)
            codes = codes[codes >= self._min_count]
            self._echoes = codes.astype(">u2").tobytes().ljust(34, b"\0")
            self._listen(reach)
        if value in ANN_COUNT_US:
            self._set_gates(ANN_COUNT_US[value])

    @property
    def _min_count(self) -> int:
        """The least count of an echo, in the unit of the last ranging."""
        return math.ceil(self.min_range_cm * COUNT_US["cm"] / COUNT_US[self._output])

    def _set_gates(self, count_us: float) -> None:
        """Set the register of each gate with an echo; ANN mode ignores gain and range registers."""
        time = self.fire("us")
        echoes = time[time > 0]
        gates = np.zeros(32, dtype=np.uint8)
        gates[np.minimum(echoes // GATE_US, 31)] = 1
        first = int(echoes[0] / count_us) if len(echoes) else 0
        self._echoes = first.to_bytes(2, "big") + gates.tobytes()
        self._listen(255)

    def _listen(self, range_register: int) -> None:
        self._ready = self.clock() + (range_register + 1) * STEP_S + READ_OUT_S


@dataclass
class Srf10Twin(Srf08Twin):
    """A simulated SRF10: one echo, no light sensor, 17 gains with the same ratio to the maximum as on the SRF08."""

    full_gain: ClassVar[int] = 16
    min_range_cm: ClassVar[int] = SRF10_MIN_RANGE_CM

    def registers(self) -> bytes:
        """Return the readable registers."""
        return bytes([REVISION, 0x80]) + self._echoes[:2]

    def settings(self) -> tuple[int, int]:
        """Return gain code of the rig and range register."""
        share = SRF10_GAINS[min(self.gain, 16)] / SRF10_GAINS[-1]
        return int(np.argmin(np.abs(np.log(np.array(GAINS) / GAINS[-1] / share)))), self.range_register


@dataclass
class Srf02Twin(Srf08Twin):
    """A simulated SRF02: one echo, fixed gain and range."""

    min_range_cm: ClassVar[int] = SRF02_MIN_RANGE_CM

    def registers(self) -> bytes:
        """Return the readable registers."""
        return bytes([REVISION, 0x80]) + self._echoes[:2] + self._min_count.to_bytes(2, "big")

    def settings(self) -> tuple[int, int]:
        """Return maximum gain and range."""
        return 31, 255
