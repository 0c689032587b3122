"""Ring-down of the transducer after a burst, which the comparator may take for an echo, or which hides one."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from acquisition.arrays import Floats
from noise.effects.base import EchoSample, Effect, Parameter, Stage, most_frequent
from noise.effects.state import MIN_SPREAD_M, Later, Path, State, new_path, wall_level_db

MAX_RANGE_M = 0.8  # largest reading of ring-down; chosen here
MIN_READINGS = 4  # early readings required for initial values; chosen here
EARLIER_SHARES = (0.0, 0.1)  # shares of near readings that may have another cause and lie nearer; chosen here
TYPICAL_MAX_M = 0.2  # largest typical reading of ring-down; chosen here
CLUSTER_WIDTH_M = 0.005  # readings within about one period of the carrier have one value; chosen here
CLUSTER_SHARE = 0.5  # share of early readings with that value; chosen here
MIN_STEP_M, MAX_STEP_M = 0.001, 0.01  # limits of a register step estimated from readings; chosen here


class DecayingPath(Path):
    """A path with exponential arrivals from `length` on: P(arrival <= z) = 1 - exp(-(z - length) / spread).

    Ring-down starts at its maximum, so that, unlike an echo, its detection has no lag, and no scatter of one.
    """

    def widened(self, variance: Tensor) -> DecayingPath:
        """Return the path as it is."""
        return self

    def survival(self, z: Tensor) -> Tensor:
        """Return the survival function P(registered beyond z | detected)."""
        return torch.exp(-self._past(z))

    def between(self, low: Tensor, high: Tensor) -> Tensor:
        """Return P(registered in (low, high] | detected)."""
        return -self.survival(low) * torch.expm1(self._past(low) - self._past(high))

    def _past(self, z: Tensor) -> Tensor:
        return torch.clamp(z - self.length, min=0.0) / torch.clamp(self.spread, min=MIN_SPREAD_M)


class RingDown(Effect):
    """The transducer still rings when listening begins: exponential false near echoes from `range_m` on.

    The comparator of some receivers is held as long: echoes of nearer targets are then read at `range_m`.
    """

    name = "ring_down"
    stage = Stage.PATHS
    localised = True
    confused_with = ("stuck",)
    summary = "The ring-down of the transducer is read as a near echo"
    parameters = (
        Parameter("probability", "1", 0.0, 0.0, 1.0, "chosen here", (0.2,)),
        Parameter("range_m", "m", 0.1, 0.005, 0.8, "end of blanking to 0.8 m", (0.05, 0.25), jumps=True),
        Parameter("decay_m", "m", 0.047, 0.01, 0.2, "c tau / 2, tau 220 to 460 us; wider: chosen here", (0.04,)),
        Parameter("held", "1", 0.0, 0.0, 1.0, "share of nearer echoes read at `range_m`; chosen here", (0.0,)),
    )
    probability: Tensor
    range_m: Tensor
    decay_m: Tensor
    held: Tensor

    def apply(self, state: State) -> State:
        """Add the ring-down as a path, and delay some of the target's echoes to its end."""
        length = self.range_m + torch.zeros_like(state.conditions.distance)
        delay = torch.clamp(self.range_m - state.direct.length, min=0.0)
        state = state.with_direct(state.direct.missed(Later(self.held, 1.0, delay)))
        path = vars(new_path("ring-down", length, wall_level_db(length), self.probability))
        return state.with_path(DecayingPath(**{**path, "spread": self.decay_m}))

    @classmethod
    def ambiguous(cls, echoes: EchoSample) -> bool:
        """Return whether most early readings have one near value, as those of a stuck register do."""
        early = echoes.early.range
        if len(early) < MIN_READINGS:
            return False
        median = float(np.median(early))
        return median < TYPICAL_MAX_M and float(np.mean(np.abs(early - median) < CLUSTER_WIDTH_M)) > CLUSTER_SHARE

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return the start and decay of near readings, and the range at which most nearer targets are read.

        A start beyond a reading makes it impossible, and the likelihood has no gradient at that edge.
        """
        return [*cls._of_early(echoes.early.range, len(echoes.range)), *cls._of_late(echoes.late.range)]

    @staticmethod
    def _of_late(late: Floats) -> list[dict[str, float]]:
        near = late[late < MAX_RANGE_M]
        end = most_frequent(near)
        return (
            [{"probability": 0.0, "range_m": end, "decay_m": 0.047, "held": 0.9}] if len(near) >= MIN_READINGS else []
        )

    @staticmethod
    def _of_early(early: Floats, n_echoes: int) -> list[dict[str, float]]:
        near = early[early < MAX_RANGE_M]
        if len(near) < MIN_READINGS:
            return []
        share = len(near) / n_echoes
        begins = [float(np.quantile(near, part, method="higher")) - 0.5 * _step(near) for part in EARLIER_SHARES]
        return [
            {"probability": share, "range_m": start, "decay_m": float(np.mean(near[near > start]) - start), "held": 0.0}
            for start in begins
        ]

    def statement(self) -> str:
        """Return sentences with the range and the probability, and with the share of nearer echoes read there."""
        v, said = self.values, []
        end = f"{1000 * v['range_m']:.0f} mm"
        if v["probability"] > 0.0 or v["held"] == 0.0:
            said.append(f"{self.summary} from {end} on, in {100 * v['probability']:.3g} % of pings.")
        if v["held"] > 0.0:
            said.append(f"{100 * v['held']:.3g} % of the echoes of nearer targets are read at {end}, where it ends.")
        return " ".join(said)


def _step(value: Floats) -> float:
    """Return the smallest difference of the values, m, limited to plausible steps of a register."""
    gaps = np.diff(np.unique(np.round(value, 6)))
    return float(np.clip(gaps.min(), MIN_STEP_M, MAX_STEP_M)) if len(gaps) else MIN_STEP_M
