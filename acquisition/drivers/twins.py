"""Twins: simulated devices on the same wire, so that the real drivers run unchanged."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from acquisition.bench import Rig
from acquisition.drivers.srf08 import COMMAND, GAIN, RANGE, RANGING, UNLOCK
from acquisition.ping import Ping

REVISION = 10
NACK = 121  # EREMOTEIO
READ_FLAG = 0x0001  # I2C_M_RD of an i2c message
GENERAL_CALL = 0
READ_OUT = 1e-3  # s from the end of listening until the sensor answers again
CONDITION = ("distance", "angle", "incidence", "reflectance", "time")
OUTPUTS = {code: output for output, code in RANGING.items()}


@dataclass
class TwinClock:
    """Time that passes only when somebody sleeps, s."""

    now: float = 0.0

    def __call__(self) -> float:
        """Return the time."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds


@dataclass
class BadWire:
    """How the twin's wire fails, as probabilities a transfer.

    Attributes:
        nack: a transfer is not acknowledged.
        lost_write: a write is acknowledged and never arrives.
        stuck: the line reads 0xFF, whatever is asked.
    """

    nack: float = 0.0
    lost_write: float = 0.0
    stuck: bool = False


@dataclass
class Srf08Twin:
    """An SRF08 on an SMBus-shaped bus, hearing through the rig what is placed before it.

    Attributes:
        rig: unit and laboratory; its gain, range and output are the twin's registers instead.
        rng: all randomness.
        address: 7-bit.
        clock: the twin's time; give its `sleep` and itself to the driver.
        wire: faults.
        busy_reads_ones: while busy a read gives 0xFF rather than no acknowledge.
    """

    rig: Rig
    rng: np.random.Generator
    address: int = 0x70
    clock: TwinClock = field(default_factory=TwinClock)
    wire: BadWire = field(default_factory=BadWire)
    busy_reads_ones: bool = False

    def __post_init__(self) -> None:
        """Power up with nothing in front."""
        self._drift = self.rig.draw_drift(self.rng)
        self._before: Ping | None = None
        self._ready = 0.0
        self._unlocking: list[int] = []
        self._echoes = bytes(34)
        self.power_cycle()
        self.place(Ping.of(distance=1.0, reflectance=0.0))

    def power_cycle(self) -> None:
        """Forget gain and range, as the sensor's RAM does."""
        self.gain, self.range_register = 31, 255

    def place(self, ping: Ping) -> None:
        """Set up what one ping describes, with the scatter of the rig's setup, until the next call."""
        self._placed = self.rig.place(ping[:1], self.rng)

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Take a write to registers 0 to 2."""
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
        """Run a register pointer and the read that follows it."""
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

    def _transfer(self, address: int, write: bool) -> None:
        """Acknowledge, or not."""
        called = address == self.address or (write and address == GENERAL_CALL)
        deaf = self.clock() < self._ready and (write or not self.busy_reads_ones)
        if not called or deaf or self.rng.random() < self.wire.nack:
            raise OSError(NACK, "Remote I/O error")

    def _read(self, address: int, register: int, count: int) -> bytes:
        self._transfer(address, write=False)
        if self.wire.stuck or self.clock() < self._ready:
            return b"\xff" * count
        memory = bytes([REVISION, self.rig.unit.light]) + self._echoes
        return memory[register : register + count].ljust(count, b"\xff")

    def _command(self, value: int) -> None:
        self._unlocking = [*self._unlocking, value][-4:]
        if tuple(self._unlocking[:3]) == UNLOCK and value % 2 == 0 and 0xE0 <= value <= 0xFE:
            self.address = value >> 1
        if value in OUTPUTS:
            self._range(value)

    def _range(self, command: int) -> None:
        """Hear the ping, with the one before it still under way."""
        now = self.clock()
        # a gain beyond the table is undocumented; the twin takes its lowest five bits
        asked = replace(self.rig.setup, gain=self.gain & 31, range_register=self.range_register)
        setup = replace(
            asked, output=OUTPUTS[command], placement_m=0.0, placement_deg=0.0, tilt_deg=0.0, zero_m=0.0, pivot_m=0.0
        )
        this = replace(self._placed, time=np.array([now]))
        pings = this if self._before is None else _joined(self._before, this)
        self._echoes = Rig(self.rig.unit, setup).ping(pings, self.rng, self._drift).code[-1].astype(">u2").tobytes()
        self._before, self._ready = this, now + setup.listening + READ_OUT


def _joined(first: Ping, second: Ping) -> Ping:
    """Return two single pings as one run."""
    both = {name: np.append(getattr(first, name), getattr(second, name)) for name in CONDITION}
    logged = {
        name: np.append(first.covariates[name], second.covariates[name])
        for name in first.covariates
        if name in second.covariates
    }
    return Ping.of(**both, **logged)
