"""The readings of a simulator as a model, so that the differences of a diagnosis act on them and not on a law of them.

The simulator's reading of each ping is logged beside its condition, in the columns `SIMULATED`. Where the simulator
heard an echo, the law is certain of its step of the register. Where it heard none, an echo that the differences make
audible has the range that another law expects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import EchoStatus, Ping, Reading
from acquisition.arguments import checked
from acquisition.arrays import Floats
from acquisition.ping import check_pairs
from noise.law import EchoLaw
from noise.model import SonarModel

SIMULATED = ("simulated_range_m", "simulated_status")
RARE = 1e-9  # probability that stands for that of an echo where the simulator heard none; only its ranges matter


def with_simulated(ping: Ping, simulated: Reading) -> Ping:
    """Return pings that carry the readings of a simulator, (n,), in the columns `SIMULATED`."""
    check_pairs("simulated", ping, simulated)
    values = (simulated.range, simulated.status.astype(np.float64))
    return replace(ping, covariates={**ping.covariates, **dict(zip(SIMULATED, values, strict=True))})


class ReplayLaw(EchoLaw):
    """Given readings.

    Attributes:
        given: readings, (n,).
        other: law of the ranges where no echo was given.
    """

    uniform_per_ping = True

    def __init__(self, given: Reading, other: EchoLaw) -> None:
        super().__init__(other.distance, other.resolution, other.max_range)
        self.given, self.other = given, other
        self._scale = np.where(other.echo > 0.0, RARE / np.maximum(other.echo, 1e-300), 0.0)

    def _arrival(self, z: Floats) -> Floats:
        within = np.clip((z - self.given.range) / self.resolution + 0.5, 0.0, 1.0)
        return np.where(self.given.echo, within, self._scale * self.other.arrival(z))

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer): 1 where the simulator gave no answer, (n,)."""
        return (self.given.status == EchoStatus.NO_ANSWER).astype(np.float64)


@dataclass(frozen=True)
class Replay:
    """A simulator whose reading of each ping is logged beside the condition.

    Args:
        other: model of the range of an echo where the simulator heard none.
        resolution: step of its register, m.
    """

    other: SonarModel
    resolution: float

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading."""
        return self.other.remembers

    @checked
    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the law of n pings; that of the other model where the simulator's readings are not given."""
        law = self.other.law(ping, past)
        if not set(SIMULATED) <= ping.covariates.keys():
            return law
        range_, status = (ping.covariates[name] for name in SIMULATED)
        law.resolution = self.resolution
        return ReplayLaw(Reading.of(range_, status.astype(np.uint8)), law)

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain data."""
        other: Any = self.other
        return {"kind": "replay", "other": other.to_dict(), "resolution": self.resolution}
