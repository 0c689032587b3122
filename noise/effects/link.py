"""Link effects: readings that are replaced between the register and the host."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from acquisition import EchoStatus
from noise.effects.base import EchoSample, Effect, Parameter, Stage
from noise.effects.state import Atom, State, ndtr, number

FULL_SCALE = 11.008  # m; SRF08 with range register 255
EDGE, BEYOND = 0.05, 4.0  # of the span: width of its end, and where the density has become zero; chosen here
MAX_GUESSES, MIN_REPEATS = 3, 3  # candidate values of a stuck register, and their least number of repeats; chosen here


class Spike(Effect):
    """With `probability` the reading is replaced by a uniform random one: the thesis's SHORT fault.

    Readings show where the uniform distribution ends no better than they are dense there, so that its density falls
    about `span_m` over a width of `EDGE` spans. None is impossible, and the likelihood has a gradient everywhere.
    """

    name = "spike"
    stage = Stage.SEQUENCE
    localised = True
    by_ping = True
    summary = "Some readings are replaced by random ones"
    parameters = (
        Parameter(
            "probability", "1", 0.0, 0.0, 0.5, "Sharma et al. (2010) SHORT; rate: chosen here", (0.01,), adds=True
        ),
        Parameter("span_m", "m", FULL_SCALE, 0.1, 20.0, "scale of the register: Devantech SRF08", (FULL_SCALE,)),
    )
    probability: Tensor
    span_m: Tensor

    def apply(self, state: State) -> State:
        """Add a uniform replacement."""
        zero = number(0.0)
        return state.with_atom(Atom(self.probability, self._uniform, zero, zero))

    def statement(self) -> str:
        """Return a sentence with the probability."""
        return (
            f"{self.summary}: {100 * self.values['probability']:.3g} % of pings, up to {self.values['span_m']:.3g} m."
        )

    def _uniform(self, edge: Tensor) -> Tensor:
        """Return the integral of the density 1 / (1 + exp((r - span) / width)), normalised."""
        least = -EDGE * math.log1p(math.exp(-1.0 / EDGE))
        inside = -EDGE * torch.logaddexp(-torch.clamp(edge / self.span_m, 0.0, BEYOND) / EDGE, number(-1.0 / EDGE))
        return (inside - least) / (1.0 - least)


class DroppedReading(Effect):
    """With `probability` an echo is reported as no echo: a transfer failed."""

    name = "dropped_reading"
    stage = Stage.SEQUENCE
    localised = True
    by_ping = True
    summary = "Some readings are lost, regardless of the target"
    parameters = (
        Parameter("probability", "1", 0.0, 0.0, 0.9, "bus faults 0.1 to 10 %; wider: chosen here", (0.02,), adds=True),
    )
    probability: Tensor

    def apply(self, state: State) -> State:
        """Add a replacement by no echo."""
        return state.with_atom(Atom(self.probability, torch.zeros_like, number(1.0), number(0.0)))

    def statement(self) -> str:
        """Return a sentence with the probability."""
        return f"{self.summary}, in {100 * self.values['probability']:.3g} % of pings."


class StaleRepeat(Effect):
    """With `probability` the register still contains the previous reading: the command was lost."""

    name = "stale_repeat"
    stage = Stage.SEQUENCE
    localised = True
    summary = "Some readings repeat the previous one"
    parameters = (Parameter("probability", "1", 0.0, 0.0, 0.9, "lost commands 0 to 5 %; wider: chosen here", (0.02,)),)
    remembers = True
    probability: Tensor

    def apply(self, state: State) -> State:
        """Add a replacement by the previous reading, if there is one."""
        past, status = state.conditions.past_range, state.conditions.past_status
        known = (status != EchoStatus.NO_ANSWER).to(torch.float64)
        echo = (status == EchoStatus.ECHO).to(torch.float64)
        atom = Atom(self.probability * known, lambda edge: echo * (edge >= past), 1.0 - echo, number(0.0))
        return state.with_atom(atom)

    def statement(self) -> str:
        """Return a sentence with the probability."""
        return f"{self.summary}, in {100 * self.values['probability']:.3g} % of pings."


class Stuck(Effect):
    """With `probability` the sensor gives a constant reading: the thesis's CONSTANT fault.

    `value_m` is a value of the register and has no useful derivative: a fit must start at the right one, which is the
    most frequent of the readings away from the target.
    """

    name = "stuck"
    fixed_range = "value_m"
    stage = Stage.SEQUENCE
    localised = True
    by_ping = True
    summary = "Some readings have a constant value, regardless of the target"
    parameters = (
        Parameter(
            "probability", "1", 0.0, 0.0, 0.999, "Sharma et al. (2010) CONSTANT; rate: chosen here", (0.02,), adds=True
        ),
        Parameter("value_m", "m", 1.0, 0.001, 20.0, "value of the register; chosen here", (1.0,), jumps=True),
    )
    probability: Tensor
    value_m: Tensor

    def apply(self, state: State) -> State:
        """Add a replacement by the constant."""
        zero = number(0.0)
        return state.with_atom(Atom(self.probability, self._from_value, zero, zero))

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return the most frequent exact readings away from the target."""
        value, count = np.unique(np.round(echoes.off_target.range, 6), return_counts=True)
        often = [k for k in np.argsort(-count, kind="stable")[:MAX_GUESSES] if count[k] >= MIN_REPEATS]
        return [{"probability": float(count[k] / len(echoes.range)), "value_m": float(value[k])} for k in often]

    def _from_value(self, edge: Tensor) -> Tensor:
        return (edge >= self.value_m).to(torch.float64)

    def statement(self) -> str:
        """Return a sentence with the value and the probability."""
        v = self.values
        share = f"{100 * v['probability']:.3g} % of pings"
        return f"The reading is {1000 * v['value_m']:.0f} mm in {share}, regardless of the target."


class NoiseBurst(Effect):
    """With `probability` an echo has a normal error of `sigma_m` about what it would read: the thesis's NOISE fault."""

    name = "noise_burst"
    stage = Stage.SEQUENCE
    localised = True
    by_ping = True
    summary = "Some readings scatter much more than the others"
    parameters = (
        Parameter(
            "probability", "1", 0.0, 0.0, 0.9, "Sharma et al. (2010) NOISE; rate: chosen here", (0.05,), adds=True
        ),
        Parameter("sigma_m", "m", 0.1, 0.005, 0.6, "wider is a spike: chosen here", (0.05, 0.3)),
    )
    probability: Tensor
    sigma_m: Tensor

    def apply(self, state: State) -> State:
        """Add a replacement by a wide normal about the reading of the direct echo."""
        centre = state.scale * (state.direct.length + _mean_level(state.direct.lag)) + state.offset
        zero = number(0.0)
        atom = Atom(self.probability, lambda edge: ndtr((edge - centre) / self.sigma_m), zero, zero, of_echo=True)
        return state.with_atom(atom)

    def statement(self) -> str:
        """Return a sentence with the scatter and the probability."""
        v = self.values
        return f"{self.summary}, by {1000 * v['sigma_m']:.0f} mm, in {100 * v['probability']:.3g} % of echoes."


class CorruptedByte(Effect):
    """With `probability` one bit of an echo's register is wrong: the count changes by a power of two.

    All bits are equally likely; the count increases as often as it decreases, as long as it stays positive.
    """

    name = "corrupted_byte"
    stage = Stage.SEQUENCE
    localised = True
    by_ping = True
    summary = "Some readings have a wrong bit: an error of a power of two"
    parameters = (
        Parameter("probability", "1", 0.0, 0.0, 0.5, "bus faults 0.01 to 1 %; wider: chosen here", (0.03,), adds=True),
        Parameter(
            "unit_m", "m", 0.01, 1e-4, 0.03, "unit of the register: cm, inch, us", (0.01, 0.0254, 1.7241e-4), jumps=True
        ),
    )
    bits = 16
    probability: Tensor
    unit_m: Tensor

    def apply(self, state: State) -> State:
        """Add a replacement by the direct echo's reading plus or minus a power of two, if positive."""
        centre = state.scale * (state.direct.length + _mean_level(state.direct.lag)) + state.offset
        power = 2.0 ** torch.arange(self.bits, dtype=torch.float64)[:, None] * self.unit_m
        places = torch.cat([centre + power, centre - power])
        sigma = torch.sqrt(state.direct.spread**2 + (self.unit_m / 2.0) ** 2)
        allowed = (places > 0).to(torch.float64)
        more, less = allowed.chunk(2)
        per_bit = allowed / torch.clamp(more + less, min=1.0).tile(2, *[1] * (more.ndim - 1))
        below = ndtr(-torch.clamp(places, min=0.0) / sigma)  # negative places have weight zero
        share = per_bit / per_bit.sum(dim=0) / (1.0 - below)

        def cdf(edge: Tensor) -> Tensor:
            inside = ndtr((edge.unsqueeze(-2) - places) / sigma) - below
            return (share * torch.clamp(inside, min=0.0)).sum(dim=-2)

        zero = number(0.0)
        return state.with_atom(Atom(self.probability, cdf, zero, zero, of_echo=True))

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return the step on whose multiples all readings lie: a wrong bit changes the count of the same register."""
        share, unit = cls.parameters
        known = unit.low <= echoes.grid_m <= unit.high
        return [{share.name: share.starts[0], unit.name: echoes.grid_m}] if known else []

    def statement(self) -> str:
        """Return a sentence with the probability."""
        return f"{self.summary}, in {100 * self.values['probability']:.3g} % of echoes."


def _mean_level(lag: Tensor) -> Tensor:
    """Return a lag averaged over the nodes of the latent level if it depends on them."""
    return lag.mean(dim=0) if lag.ndim == 2 else lag
