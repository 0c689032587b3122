"""What pings leave in the sensor's registers, and the ranges that a host makes of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.acoustics.air import Floats
from acquisition.bench.firmware import PER_UNIT
from acquisition.bench.setup import Setup
from acquisition.ping import EchoStatus, Reading

CM = 0.01
INCH = 0.0254
METRES = {"cm": CM, "inch": INCH, "us": PER_UNIT["us"] / PER_UNIT["cm"] * CM}


NOISE = -1


@dataclass(frozen=True)
class Truth:
    """What really happened in n pings, which no sensor tells; groups are those of `bench.arrivals.GROUPS`.

    Attributes:
        time: when each group's sound began to arrive, after the burst's start, s, (n, groups); NaN where it has none.
        level_db: how far each group's loudest moment is over the comparator's threshold, dB, (n, groups); -inf: none.
        cause: group that tripped the comparator first, (n,); `NOISE` where none was near the threshold then, or there
            was no echo.
        period: which carrier period of that group's sound it was, (n,); 0 without a cause.
    """

    time: Floats
    level_db: Floats
    cause: NDArray[np.int64]
    period: NDArray[np.int64]

    @classmethod
    def joined(cls, parts: list[Truth]) -> Truth:
        """Return all parts as one."""
        names = ("time", "level_db", "cause", "period")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def __getitem__(self, rows: NDArray[np.int64]) -> Truth:
        """Return that of some pings."""
        return Truth(self.time[rows], self.level_db[rows], self.cause[rows], self.period[rows])


@dataclass(frozen=True)
class Registers:
    """What n pings left in the registers.

    Attributes:
        code: echo registers 2..35 as whole numbers in the unit of output, 0 for none, (n, 17) uint16.
        answered: whether the sensor answered at all, (n,).
        temperature_c: of the air at each ping, degC, (n,); no register holds it, a thermometer would.
        fault: what the wire did to each ping, (n,), a `Link` each.
        humidity_pct: of the air at each ping, (n,).
        truth: what really happened, where it was asked for.
    """

    code: NDArray[np.uint16]
    answered: NDArray[np.bool_]
    temperature_c: Floats
    fault: NDArray[np.uint8]
    humidity_pct: Floats
    truth: Truth | None = None

    def __getitem__(self, rows: NDArray[np.int64]) -> Registers:
        """Return those of some pings."""
        truth = None if self.truth is None else self.truth[rows]
        air = (self.temperature_c[rows], self.humidity_pct[rows])
        return Registers(self.code[rows], self.answered[rows], air[0], self.fault[rows], air[1], truth)

    def reading(self, setup: Setup) -> Reading:
        """Return the registers as ranges, keeping as many further echoes as any ping has."""
        code = np.where(self.answered[:, None], self.code, 0)
        status = np.where(code[:, 0] > 0, EchoStatus.ECHO, EchoStatus.NO_ECHO)
        status = np.where(self.answered, status, EchoStatus.NO_ANSWER)
        deepest = int((code > 0).sum(axis=1).max(initial=1))
        ranges = code[:, :deepest] * METRES[setup.output]
        return Reading.of(ranges[:, 0], status, ranges[:, 1:])
