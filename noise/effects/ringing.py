"""The transducer's own ringing after a burst, which a comparator may take for an echo."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from noise.effects.base import FLOOR_M, Effect, Parameter, Path, Seen, Stage, State, new_path, wall_level_db
from noise.law import Floats

FARTHEST_M = 0.8  # that ringing is read at; ours
FEWEST = 4  # early readings, to begin from them; ours
SHARES = (0.0, 0.1)  # of near readings that something else may have brought still nearer; ours
NEAREST_M = 0.2  # up to which ringing is usually read at; ours
ONE_PLACE_M = 0.005  # a wave of the carrier at the most, within which readings are one and the same place; ours
MOST_OF_THEM = 0.5  # share of early readings that one place has; ours
FINEST_STEP_M, WIDEST_STEP_M = 0.001, 0.01  # of a register, within which its values say how wide it is; ours


class DecayingPath(Path):
    """A way whose arrivals begin at `length` and thin out over `spread`: 1 - exp(-(z - length) / spread).

    Ringing only falls: no faint beginning of it is waited for, as of an echo, so that it is never late.
    """

    def lateness(self, z: Tensor) -> Tensor:
        """Return P(registered beyond z | detected)."""
        return torch.exp(-self._past(z))

    def between(self, low: Tensor, high: Tensor) -> Tensor:
        """Return P(registered in (low, high] | detected)."""
        return -self.lateness(low) * torch.expm1(self._past(low) - self._past(high))

    def _past(self, z: Tensor) -> Tensor:
        return torch.clamp(z - self.length, min=0.0) / torch.clamp(self.spread, min=FLOOR_M)


class RingDown(Effect):
    """The transducer still rings when listening begins: false near echoes from `range_m` on, thinning out."""

    name = "ring_down"
    stage = Stage.PATHS
    strikes = True
    passes_for = ("stuck",)
    summary = "The transducer's own ringing is read as a near echo"
    parameters = (
        Parameter("probability", "1", 0.0, 0.0, 1.0, "ours", (0.2,)),
        Parameter("range_m", "m", 0.1, 0.005, 0.8, "end of blanking to 0.8 m", (0.05, 0.25)),
        Parameter("decay_m", "m", 0.047, 0.0005, 0.2, "c tau / 2, tau 220 to 460 us; wider: ours", (0.04,)),
    )
    probability: Tensor
    range_m: Tensor
    decay_m: Tensor

    def apply(self, state: State) -> State:
        """Add it as a way of its own."""
        length = self.range_m + torch.zeros_like(state.conditions.distance)
        path = vars(new_path("ring-down", length, wall_level_db(length), self.probability))
        return state.with_path(DecayingPath(**{**path, "spread": self.decay_m}))

    @classmethod
    def hidden(cls, seen: Seen) -> bool:
        """Tell whether most early readings are from one place that is near enough to be ringing."""
        early = seen.early.range
        if len(early) < FEWEST:
            return False
        usual = float(np.median(early))
        return usual < NEAREST_M and float(np.mean(np.abs(early - usual) < ONE_PLACE_M)) > MOST_OF_THEM

    @classmethod
    def guesses(cls, seen: Seen) -> list[dict[str, float]]:
        """Return where near readings begin and how they thin out: to begin beyond one of them is to forbid it.

        No climb finds that edge by its slope, and what rings as hard as it can is always read at the same digit.
        """
        early = seen.early.range
        near = early[early < FARTHEST_M]
        if len(near) < FEWEST:
            return []
        share = len(near) / len(seen.range)
        begins = [float(np.quantile(near, part, method="higher")) - 0.5 * _step(near) for part in SHARES]
        return [
            {"probability": share, "range_m": begun, "decay_m": float(np.mean(near[near > begun]) - begun)}
            for begun in begins
        ]

    def statement(self) -> str:
        """Return where and how often."""
        v = self.values
        return f"{self.summary} from {1000 * v['range_m']:.0f} mm on, in {100 * v['probability']:.3g} % of pings."


def _step(value: Floats) -> float:
    """Return the least distance between different values, m, within what registers count in."""
    gaps = np.diff(np.unique(np.round(value, 6)))
    return float(np.clip(gaps.min(), FINEST_STEP_M, WIDEST_STEP_M)) if len(gaps) else FINEST_STEP_M
