"""Receiver effects: how strong an echo must be to count, and what the clock makes of its time."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from noise.effects.base import Effect, Parameter, Path, Stage, State


class Sensitivity(Effect):
    """Every echo is `loss_db` weaker against the threshold than in an ideal sonar: level -> level - loss."""

    name = "sensitivity"
    stage = Stage.MEDIUM
    summary = "The receiver hears less than an ideal one: echoes near its threshold are missed"
    parameters = (
        Parameter("loss_db", "dB", 0.0, 0.0, 80.0, "gain table of the SRF08, unit spread: ours", (30.0, 40.0, 50.0)),
    )
    loss_db: Tensor

    def apply(self, state: State) -> State:
        """Lower the level of every path."""
        return state.map_paths(lambda path: replace(path, level_db=path.level_db - self.loss_db))


class ClockScale(Effect):
    """The timer, or the constant that turns time into range, is off: register = (1 + error) * range."""

    name = "clock_scale"
    stage = Stage.REGISTER
    summary = "The sensor's clock, or its constant from time to range, is off: all ranges are scaled"
    parameters = (
        Parameter("error", "1", 0.0, -0.05, 0.05, "ceramic resonators +-0.5 %; unit constants: ours", (0.0,)),
    )
    error: Tensor

    def apply(self, state: State) -> State:
        """Scale the register."""
        factor = 1.0 + self.error
        return replace(state, scale=state.scale * factor, offset=state.offset * factor)


class ZeroOffset(Effect):
    """The range is counted from another plane than distances are: register = range + offset."""

    name = "zero_offset"
    stage = Stage.REGISTER
    summary = "Ranges are counted from another plane than the true distances: all are shifted alike"
    parameters = (
        Parameter("offset_m", "m", 0.0, -0.1, 0.1, "firmware delay and mounting, +-30 mm; wider: ours", (0.0,)),
    )
    offset_m: Tensor

    def apply(self, state: State) -> State:
        """Shift the register."""
        return replace(state, offset=state.offset + self.offset_m)


class TravelTimeJitter(Effect):
    """Arrivals scatter from ping to ping: spread^2 -> spread^2 + sigma^2 + (per_metre * length)^2."""

    name = "travel_time_jitter"
    stage = Stage.DETECTOR
    summary = "Readings scatter from ping to ping"
    parameters = (
        Parameter("sigma_m", "m", 0.0, 0.0, 0.2, "electronic noise on the slope of the echo: ours", (0.003,)),
        Parameter("per_metre", "1", 0.0, 0.0, 0.1, "thermal eddies, 0.1 to 1 mm at 6 m; wider: ours", (0.001,)),
    )
    sigma_m: Tensor
    per_metre: Tensor

    def apply(self, state: State) -> State:
        """Widen every path."""
        return state.map_paths(self._widen)

    def _widen(self, path: Path) -> Path:
        variance = path.spread**2 + self.sigma_m**2 + (self.per_metre * path.length) ** 2
        # sqrt has no derivative at 0: the tiny constant keeps gradients finite and is removed again
        return replace(path, spread=torch.sqrt(variance + 1e-18) - 1e-9)
