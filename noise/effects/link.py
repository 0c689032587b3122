"""Link effects: what replaces a reading on its way to whoever asked for it."""

from __future__ import annotations

import torch
from torch import Tensor

from acquisition import EchoStatus
from noise.effects.base import Atom, Effect, Parameter, Stage, State, ndtr, number

FULL_SCALE = 11.008  # m; SRF08 with range register 255


class Spike(Effect):
    """With `probability` the reading is replaced by one anywhere on the scale: the thesis's SHORT fault."""

    name = "spike"
    stage = Stage.SEQUENCE
    summary = "Now and then a reading is replaced by an arbitrary one"
    parameters = (
        Parameter("probability", "1", 0.0, 0.0, 0.5, "Sharma et al. (2010) SHORT; rate: ours", (0.01,)),
        Parameter("span_m", "m", FULL_SCALE, 0.1, 20.0, "register's scale: Devantech SRF08", (FULL_SCALE,)),
    )
    probability: Tensor
    span_m: Tensor

    def apply(self, state: State) -> State:
        """Mix in a uniform reading."""
        zero = number(0.0)
        return state.with_atom(Atom(self.probability, self._uniform, zero, zero))

    def statement(self) -> str:
        """Return how often."""
        return (
            f"{self.summary}: {100 * self.values['probability']:.3g} % of pings, up to {self.values['span_m']:.3g} m."
        )

    def _uniform(self, edge: Tensor) -> Tensor:
        return torch.clamp(edge / self.span_m, 0.0, 1.0)


class DroppedReading(Effect):
    """With `probability` the sensor says nothing of an echo it heard: a wire or a poll failed."""

    name = "dropped_reading"
    stage = Stage.SEQUENCE
    summary = "Now and then a reading is lost, whatever the target"
    parameters = (Parameter("probability", "1", 0.0, 0.0, 0.9, "bus faults 0.1 to 10 %; wider: ours", (0.02,)),)
    probability: Tensor

    def apply(self, state: State) -> State:
        """Mix in silence."""
        return state.with_atom(Atom(self.probability, torch.zeros_like, number(1.0), number(0.0)))

    def statement(self) -> str:
        """Return how often."""
        return f"{self.summary}, in {100 * self.values['probability']:.3g} % of pings."


class StaleRepeat(Effect):
    """With `probability` the register still holds the previous reading: the command was lost."""

    name = "stale_repeat"
    stage = Stage.SEQUENCE
    summary = "Now and then the previous reading is given again"
    parameters = (Parameter("probability", "1", 0.0, 0.0, 0.9, "lost commands 0 to 5 %; wider: ours", (0.02,)),)
    remembers = True
    probability: Tensor

    def apply(self, state: State) -> State:
        """Mix in the previous reading, where there was one."""
        past, status = state.conditions.past_range, state.conditions.past_status
        known = (status != EchoStatus.NO_ANSWER).to(torch.float64)
        echo = (status == EchoStatus.ECHO).to(torch.float64)
        atom = Atom(self.probability * known, lambda edge: echo * (edge >= past), 1.0 - echo, number(0.0))
        return state.with_atom(atom)

    def statement(self) -> str:
        """Return how often."""
        return f"{self.summary}, in {100 * self.values['probability']:.3g} % of pings."


class Stuck(Effect):
    """With `probability` the sensor gives one and the same reading: the thesis's CONSTANT fault.

    `value_m` is a place on the register's grid and has no useful derivative: a fit must start at the right one, which
    is the most frequent reading.
    """

    name = "stuck"
    stage = Stage.SEQUENCE
    summary = "Now and then the sensor gives one and the same reading, whatever the target"
    parameters = (
        Parameter("probability", "1", 0.0, 0.0, 0.9, "Sharma et al. (2010) CONSTANT; rate: ours", (0.02,)),
        Parameter("value_m", "m", 1.0, 0.001, 20.0, "on the register; ours", (1.0,)),
    )
    probability: Tensor
    value_m: Tensor

    def apply(self, state: State) -> State:
        """Mix in the constant."""
        zero = number(0.0)
        return state.with_atom(Atom(self.probability, self._from_value, zero, zero))

    def _from_value(self, edge: Tensor) -> Tensor:
        return (edge >= self.value_m).to(torch.float64)

    def statement(self) -> str:
        """Return which and how often."""
        v = self.values
        often = f"{100 * v['probability']:.3g} % of pings"
        return (
            f"The sensor gives one and the same reading, {1000 * v['value_m']:.0f} mm, in {often}, whatever the target."
        )


class NoiseBurst(Effect):
    """With `probability` a reading is scattered by `sigma_m` about the true range: the thesis's NOISE fault."""

    name = "noise_burst"
    stage = Stage.SEQUENCE
    summary = "Some readings scatter far more than the others"
    parameters = (
        Parameter("probability", "1", 0.0, 0.0, 0.9, "Sharma et al. (2010) NOISE; rate: ours", (0.05,)),
        Parameter("sigma_m", "m", 0.1, 0.005, 2.0, "ours", (0.05, 0.3)),
    )
    probability: Tensor
    sigma_m: Tensor

    def apply(self, state: State) -> State:
        """Mix in a wide normal about where the direct echo reads."""
        centre = state.scale * state.direct.length + state.offset
        zero = number(0.0)
        atom = Atom(self.probability, lambda edge: ndtr((edge - centre) / self.sigma_m), zero, zero)
        return state.with_atom(atom)

    def statement(self) -> str:
        """Return how far and how often."""
        v = self.values
        return f"{self.summary}, by {1000 * v['sigma_m']:.0f} mm, in {100 * v['probability']:.3g} % of pings."
