"""Register contents of pings, and the ranges computed from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import Floats
from acquisition.bench.firmware import PER_UNIT
from acquisition.bench.laboratory.setup import Setup
from acquisition.ping import EchoStatus, Reading

CM = 0.01
INCH = 0.0254
METRES = {"cm": CM, "inch": INCH, "us": PER_UNIT["us"] / PER_UNIT["cm"] * CM}
NOISE = -1


@dataclass(frozen=True)
class TrueEchoes:
    """True echoes of n pings, which no sensor reports; groups are those of `acoustics.arrivals.GROUPS`.

    Attributes:
        time: arrival time of each group after the start of the burst, s, (n, groups); NaN for none.
        level_db: peak level of each group relative to the comparator's threshold, dB, (n, groups); -inf for none.
        cause: group that first tripped the comparator, (n,); `NOISE` if none was near the threshold or without echo.
        period: carrier period of that group's sound at the crossing, (n,); 0 without a cause.
    """

    time: Floats
    level_db: Floats
    cause: NDArray[np.int64]
    period: NDArray[np.int64]

    @classmethod
    def joined(cls, parts: list[TrueEchoes]) -> TrueEchoes:
        """Concatenate several sets."""
        names = ("time", "level_db", "cause", "period")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def __getitem__(self, rows: NDArray[np.int64]) -> TrueEchoes:
        """Return those of some pings."""
        return TrueEchoes(self.time[rows], self.level_db[rows], self.cause[rows], self.period[rows])


@dataclass(frozen=True)
class Registers:
    """Register contents after n pings.

    Attributes:
        code: echo registers 2..35 as integers in the unit of output, 0 for none, (n, 17) uint16.
        answered: whether the sensor answered, (n,).
        temperature_c: of the air at each ping, degC, (n,); measured by a thermometer, not a register.
        fault: bus fault of each ping, (n,), a `Link` each.
        humidity_pct: of the air at each ping, (n,).
        truth: the true echoes, if requested.
    """

    code: NDArray[np.uint16]
    answered: NDArray[np.bool_]
    temperature_c: Floats
    fault: NDArray[np.uint8]
    humidity_pct: Floats
    truth: TrueEchoes | None = None

    def __getitem__(self, rows: NDArray[np.int64]) -> Registers:
        """Return the registers of some pings."""
        truth = None if self.truth is None else self.truth[rows]
        air = (self.temperature_c[rows], self.humidity_pct[rows])
        return Registers(self.code[rows], self.answered[rows], air[0], self.fault[rows], air[1], truth)

    def reading(self, setup: Setup) -> Reading:
        """Return the registers as ranges, with as many further echoes as the ping with the most has."""
        code = np.where(self.answered[:, None], self.code, 0)
        status = np.where(code[:, 0] > 0, EchoStatus.ECHO, EchoStatus.NO_ECHO)
        status = np.where(self.answered, status, EchoStatus.NO_ANSWER)
        deepest = int((code > 0).sum(axis=1).max(initial=1))
        ranges = code[:, :deepest] * METRES[setup.output]
        return Reading.of(ranges[:, 0], status, ranges[:, 1:])
