"""What pings leave in the sensor's registers, and the ranges that a host makes of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.air import Floats
from acquisition.bench.firmware import PER_UNIT
from acquisition.bench.setup import Setup
from acquisition.ping import EchoStatus, Reading

CM = 0.01
INCH = 0.0254
METRES = {"cm": CM, "inch": INCH, "us": PER_UNIT["us"] / PER_UNIT["cm"] * CM}


@dataclass(frozen=True)
class Registers:
    """What n pings left in the registers.

    Attributes:
        code: echo registers 2..35 as whole numbers in the unit of output, 0 for none, (n, 17) uint16.
        answered: whether the sensor answered at all, (n,).
        temperature_c: of the air at each ping, degC, (n,); no register holds it, a thermometer would.
        fault: what the wire did to each ping, (n,), a `Link` each.
    """

    code: NDArray[np.uint16]
    answered: NDArray[np.bool_]
    temperature_c: Floats
    fault: NDArray[np.uint8]

    def reading(self, setup: Setup) -> Reading:
        """Return the registers as ranges, keeping as many further echoes as any ping has."""
        code = np.where(self.answered[:, None], self.code, 0)
        status = np.where(code[:, 0] > 0, EchoStatus.ECHO, EchoStatus.NO_ECHO)
        status = np.where(self.answered, status, EchoStatus.NO_ANSWER)
        deepest = int((code > 0).sum(axis=1).max(initial=1))
        ranges = code[:, :deepest] * METRES[setup.output]
        return Reading.of(ranges[:, 0], status, ranges[:, 1:])
