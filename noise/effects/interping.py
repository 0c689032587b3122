"""Inter-ping effects: sound of another ping, or of another sonar, taken for this one's."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from noise.effects.base import Effect, Parameter, Stage, State, new_path, wall_level_db
from noise.effects.medium import ASSUMED_SPEED
from noise.effects.target import presence

INTERVAL = "interval_s"  # covariate: time since the previous ping of the run, s; 0 where there was none
USUAL_INTERVAL = 0.065  # s; Devantech's advice, taken where no times were logged


class PreviousPing(Effect):
    """The previous ping's echo from a reflector at `far_m` comes back during this one: range far - c interval / 2.

    Shows as a mode that moves one to one with the interval between pings, and not at all with the distance.
    """

    name = "previous_ping"
    stage = Stage.PATHS
    summary = "A far echo of the previous ping is read as a near one of this"
    parameters = (
        presence(0.3),
        Parameter(
            "far_m", "m", 12.0, 3.0, 25.0, "c interval / 2 = 11.2 m at 65 ms, plus what is read", (9.0, 12.0, 15.0)
        ),
    )
    presence: Tensor
    far_m: Tensor

    def apply(self, state: State) -> State:
        """Add the late echo; what the interval takes off is time, not way, so warm air does not stretch it."""
        interval = state.conditions.covariates.get(INTERVAL)
        if interval is None:
            interval = torch.full_like(state.conditions.distance, USUAL_INTERVAL)
        length = self.far_m + torch.zeros_like(interval)
        early = ASSUMED_SPEED * interval / 2.0
        possible = ((interval > 0) & (early < length)).to(torch.float64)
        path = new_path("previous", length, wall_level_db(length), self.presence * possible)
        return state.with_path(replace(path, lag=-early))

    def statement(self) -> str:
        """Return where the far reflector stands."""
        v = self.values
        often = f"{100 * v['presence']:.3g} % of pings"
        return f"A far echo of the previous ping, from {v['far_m']:.2f} m, is read as a near one of this, in {often}."


class SynchronousCrosstalk(Effect):
    """Another sonar fires at the same moment: its sound reaches the reflector over `other_m` and comes back over d."""

    name = "synchronous_crosstalk"
    stage = Stage.PATHS
    summary = "Another sonar's ping is read, half as far as both distances together"
    parameters = (
        presence(0.3),
        Parameter("other_m", "m", 1.0, 0.05, 11.0, "(d1 + d2) / 2, Devantech FAQ on several sonars", (0.3, 1.0, 3.0)),
    )
    presence: Tensor
    other_m: Tensor

    def apply(self, state: State) -> State:
        """Add the way from the other sonar."""
        length = 0.5 * (state.conditions.distance + self.other_m)
        path = new_path("other sonar", length, wall_level_db(length), self.presence, state.conditions.angle)
        return state.with_path(path)

    def statement(self) -> str:
        """Return the other sonar's distance."""
        v = self.values
        often = f"{100 * v['presence']:.3g} % of pings"
        return f"Another sonar's ping is read, over a way {v['other_m']:.2f} m long to the reflector, in {often}."
