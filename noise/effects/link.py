"""Link effects: what replaces a reading on its way to whoever asked for it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from acquisition import EchoStatus
from noise.effects.base import Atom, Effect, Parameter, Seen, Stage, State, ndtr, number

FULL_SCALE = 11.008  # m; SRF08 with range register 255
MOST_GUESSES, FEWEST_SAME = 3, 3  # readings that a register may be stuck at; how often one must have come back; ours


class Spike(Effect):
    """With `probability` the reading is replaced by one anywhere on the scale: the thesis's SHORT fault."""

    name = "spike"
    stage = Stage.SEQUENCE
    strikes = True
    by_ping = True
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
    strikes = True
    by_ping = True
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
    strikes = True
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
    is the most frequent of the readings that are not the target's.
    """

    name = "stuck"
    stage = Stage.SEQUENCE
    strikes = True
    by_ping = True
    summary = "Now and then the sensor gives one and the same reading, whatever the target"
    parameters = (
        Parameter("probability", "1", 0.0, 0.0, 0.999, "Sharma et al. (2010) CONSTANT; rate: ours", (0.02,)),
        Parameter("value_m", "m", 1.0, 0.001, 20.0, "on the register; ours", (1.0,)),
    )
    probability: Tensor
    value_m: Tensor

    def apply(self, state: State) -> State:
        """Mix in the constant."""
        zero = number(0.0)
        return state.with_atom(Atom(self.probability, self._from_value, zero, zero))

    @classmethod
    def guesses(cls, seen: Seen) -> list[dict[str, float]]:
        """Return the readings that come back most often away from the target, to the digit."""
        value, count = np.unique(np.round(seen.away.range, 6), return_counts=True)
        often = [k for k in np.argsort(-count, kind="stable")[:MOST_GUESSES] if count[k] >= FEWEST_SAME]
        return [{"probability": float(count[k] / len(seen.range)), "value_m": float(value[k])} for k in often]

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
    strikes = True
    by_ping = True
    summary = "Some readings scatter far more than the others"
    parameters = (
        Parameter("probability", "1", 0.0, 0.0, 0.9, "Sharma et al. (2010) NOISE; rate: ours", (0.05,)),
        Parameter("sigma_m", "m", 0.1, 0.005, 0.6, "wider is a spike: ours", (0.05, 0.3)),
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


class CorruptedByte(Effect):
    """With `probability` one bit of the register is read wrong: the count changes by a power of two.

    Which bit is as likely as any other; the count goes up as often as down, where it can.
    """

    name = "corrupted_byte"
    stage = Stage.SEQUENCE
    strikes = True
    by_ping = True
    summary = "Now and then a bit of the reading is wrong: it is off by a power of two"
    parameters = (
        Parameter("probability", "1", 0.0, 0.0, 0.5, "bus faults 0.01 to 1 %; wider: ours", (0.03,)),
        Parameter("unit_m", "m", 0.01, 1e-4, 0.03, "what the register counts: cm, inch, us", (0.01, 0.0254, 1.7241e-4)),
    )
    bits = 16
    probability: Tensor
    unit_m: Tensor

    def apply(self, state: State) -> State:
        """Mix in readings a power of two beside where the direct echo reads; none below zero."""
        centre = state.scale * (state.direct.length + _mean_level(state.direct.lag)) + state.offset
        power = 2.0 ** torch.arange(self.bits, dtype=torch.float64)[:, None] * self.unit_m
        places = torch.cat([centre + power, centre - power])
        sigma = torch.sqrt(state.direct.spread**2 + (self.unit_m / 2.0) ** 2)
        allowed = (places > 0).to(torch.float64)
        share = allowed / allowed.sum(dim=0)

        def cdf(edge: Tensor) -> Tensor:
            edge = edge.unsqueeze(-2)
            below = ndtr(-torch.clamp(places, min=0.0) / sigma)  # those below zero are not allowed anyway
            inside = (ndtr((edge - places) / sigma) - below) / (1.0 - below)
            return (share * torch.clamp(inside, 0.0, 1.0)).sum(dim=-2)

        zero = number(0.0)
        return state.with_atom(Atom(self.probability, cdf, zero, zero))

    def statement(self) -> str:
        """Return how often."""
        return f"{self.summary}, in {100 * self.values['probability']:.3g} % of pings."


def _mean_level(lag: Tensor) -> Tensor:
    """Return a lag averaged over the latent level's nodes where it depends on them."""
    return lag.mean(dim=0) if lag.ndim == 2 else lag
