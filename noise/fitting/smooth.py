"""Smooth corrections of a physical law, in the law's own coordinates, as kernel expansions of logged conditions.

A correction f(x) of each aspect of the direct echo is a Gaussian process with a Nystroem basis: f(x) = k(x, C) alpha,
with C a sample of the conditions (Rasmussen & Williams 2006, chapter 8). The kernel has a constant, a part for each
input, and a joint part; a second expansion depends on the level of the echo and moves with it when the physics
changes. Inputs are limited to the range of the readings that were fitted, and without readings f returns to zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Self

import torch
from torch import Tensor

from acquisition import EchoStatus, ModelError
from noise.effects.base import NEAR, NEAR_M, Effect, Stage
from noise.effects.state import Atom, Conditions, Path, State, number

# aspects of the direct echo: a term in the probit of detection, a shift in m, the logarithm of a factor of the spread,
# and the log-odds of replacing the reading by an early or a late one
DETECTION, SHIFT, SPREAD, EARLY, LATE = "detection", "shift", "spread", "early", "late"
HEADS = (DETECTION, SHIFT, SPREAD, EARLY, LATE)

CERTAIN = 4.0  # probit beyond which detection or a miss is certain (3e-5), so that a correction has an effect
RARE_LOG_ODDS = -8.0  # of a tail without a correction: 3e-4, as the floor of every likelihood
MAX_LOG_SPREAD = 5.0  # limits the factor of the spread to 150
WIDTH, JOINT_WIDTH = 0.7, 1.5  # lengths of the kernel in standard deviations of the inputs; chosen here
LEVEL_DB = 6.0  # level above which the scale of levels turns from linear to logarithmic; chosen here
LEVEL_STEP = 0.5  # distance of the centres on that scale

KEPT = 4  # samples of pings whose correction is kept: those of a comparison of two files
MEMORY = ("past_error", "past_echo")
MIRRORED = "mirrored_incidence"  # with the sign of the incidence beside that of the angle: a mirror image reads alike


def column(name: str, conditions: Conditions, typical: Tensor | None = None) -> Tensor:
    """Return an input of the correction, (n,): a logged condition, the time, or a feature of the previous reading.

    Args:
        name: of the input.
        conditions: of n pings.
        typical: value that stands for a covariate that was not logged.

    Raises:
        ModelError: the covariate was not logged, and nothing stands for it.
    """
    c = conditions
    if name in c.covariates:
        return c.covariates[name]
    if name == "log_distance":
        return torch.log(torch.clamp(c.distance, min=0.02))
    if name in ("angle", "incidence"):
        return getattr(c, name).abs()
    if name == MIRRORED:
        return torch.where(c.angle == 0.0, c.incidence.abs(), c.incidence * torch.sign(c.angle))
    if name == "past_error":
        error = (c.past_range - c.distance) / (NEAR * c.distance + NEAR_M)
        return torch.where(c.past_status == EchoStatus.ECHO, torch.clamp(error, -1.0, 1.0), 0.0)
    if name == "past_echo":
        known = torch.where(c.past_status == EchoStatus.ECHO, 1.0, -1.0).to(torch.float64)
        return torch.where(c.past_status == EchoStatus.NO_ANSWER, 0.0, known)
    if name in ("reflectance", "time"):
        return getattr(c, name)
    if typical is not None:
        return typical.expand(c.distance.shape)
    raise ModelError(f"smooth term: it needs the column {name!r}, which these pings do not have; log it or set it")


@dataclass(frozen=True)
class Inputs:
    """Standardised inputs of a correction.

    Attributes:
        names: columns.
        middle, scale: of the standardisation, (d,).
        low, high: standardised range of the readings that were fitted, (d,).
    """

    names: tuple[str, ...]
    middle: Tensor
    scale: Tensor
    low: Tensor
    high: Tensor

    @classmethod
    def of(cls, names: Sequence[str], conditions: Conditions) -> Inputs:
        """Return the inputs that vary under these conditions, without duplicates."""
        columns = {name: column(name, conditions) for name in names}
        chosen: list[str] = []
        for name, x in columns.items():
            varies = float(x.max() - x.min()) > 1e-9
            if varies and not any(torch.equal(x, columns[other]) for other in chosen):
                chosen.append(name)
        if not chosen:
            chosen = list(names[:1])
        x = torch.stack([columns[name] for name in chosen], dim=-1)
        middle, scale = x.mean(0), torch.clamp(x.std(0, correction=0), min=1e-6)
        z = (x - middle) / scale
        return cls(tuple(chosen), middle, scale, z.min(0).values, z.max(0).values)

    def standardised(self, conditions: Conditions) -> Tensor:
        """Return the inputs, standardised and limited to the fitted range, (n, d); a missing covariate is its mean."""
        each = zip(self.names, self.middle, strict=True)
        x = torch.stack([column(name, conditions, middle) for name, middle in each], dim=-1)
        return torch.minimum(torch.maximum((x - self.middle) / self.scale, self.low), self.high)


def kernel(x: Tensor, centres: Tensor) -> Tensor:
    """Return the covariance of f between inputs, (n, d), and centres, (m, d), with variance 2 + constant 1: (n, m)."""
    squared = (x[:, None, :] - centres[None, :, :]) ** 2
    each = torch.exp(squared * (-0.5 / WIDTH**2)).mean(-1)
    return 1.0 + each + torch.exp(squared.sum(-1) * (-0.5 / JOINT_WIDTH**2))


def level_kernel(level: Tensor, centres: Tensor) -> Tensor:
    """Return the covariance of the part of f that depends on the level, from `level_scale`, (n, m), a line included."""
    return level[:, None] * centres + torch.exp((level[:, None] - centres) ** 2 * (-0.5 / WIDTH**2))


def level_scale(state: State) -> Tensor:
    """Return the level of the direct path on a scale that is fine at the threshold, asinh(level / 6 dB), (n,)."""
    level = state.direct.level_db
    mean = level[0] if len(level) == 1 else (torch.softmax(state.log_weight, dim=0) * level).sum(0)
    return torch.asinh(mean / LEVEL_DB).expand(state.conditions.distance.shape)


@dataclass(frozen=True)
class Sizes:
    """Scatter of the law that a correction was fitted to.

    Attributes:
        tails_m: mean lengths of the early and the late tail, m.
        placement_m: scatter of the placement, m, which the factor of the spread scales too.
        level_sd_db: scatter of the level of visits, dB, in whose units detection is certain and is corrected.
        jitter: scatter of single pings, m, and its growth with distance, 1. The factor of the spread scales so much;
            what single pings scatter more is added, as independent noise is.
    """

    tails_m: tuple[float, float]
    placement_m: float
    level_sd_db: float
    jitter: tuple[float, float]


class Smooth(Effect):
    """A smooth correction of the direct echo without a cause; `learn_smooth` fits it.

    Args:
        inputs: standardised inputs.
        centres: of the kernel, (m, d).
        alpha: weights of the kernel by aspect, (m,) each; an aspect that is absent is left unchanged.
        level_centres: of the level's kernel, (l,); inputs are limited to their range.
        beta: weights of the level's kernel by aspect, (l,) each.
        sizes: scatter of the law that is corrected.
    """

    name = "smooth"
    stage = Stage.REGISTER
    summary = "A smooth correction without a cause"
    parameters = ()

    def __init__(
        self,
        inputs: Inputs,
        centres: Tensor,
        alpha: Mapping[str, Tensor],
        level_centres: Tensor,
        beta: Mapping[str, Tensor],
        sizes: Sizes,
    ) -> None:
        super().__init__()
        self.inputs, self.centres, self.level_centres = inputs, centres, level_centres
        self.alpha, self.beta, self.sizes = dict(alpha), dict(beta), sizes
        self.remembers = any(name in MEMORY for name in inputs.names)
        self._recent: list[tuple[tuple[Tensor, ...], Tensor]] = []

    def without_tails(self) -> Self:
        """Return the correction of the direct echo alone, without early and late readings."""
        alpha, beta = ({k: v for k, v in each.items() if k not in (EARLY, LATE)} for each in (self.alpha, self.beta))
        return type(self)(self.inputs, self.centres, alpha, self.level_centres, beta, self.sizes)

    def apply(self, state: State) -> State:
        """Correct the direct echo."""
        return self.corrected(state, self.heads(state)) if self.alpha else state

    def heads(self, state: State) -> dict[str, Tensor]:
        """Return the correction of each aspect, (n,)."""
        by_level = self._expanded(level_kernel(self.level(state), self.level_centres), self.beta)
        total = self._by_condition(state.conditions) + by_level
        return dict(zip(self.alpha, total.unbind(-1), strict=True))

    def _expanded(self, covariance: Tensor, weights: Mapping[str, Tensor]) -> Tensor:
        """Return the expansion of each aspect, (n, aspects), of covariances with the centres, (n, m)."""
        return covariance @ torch.stack(list(weights.values()), dim=-1)

    def level(self, state: State) -> Tensor:
        """Return the level on its scale, limited to the fitted range, (n,)."""
        return torch.clamp(level_scale(state), float(self.level_centres[0]), float(self.level_centres[-1]))

    def _by_condition(self, conditions: Conditions) -> Tensor:
        """Return the part that depends on conditions, (n, aspects); kept while the same pings are evaluated again."""
        c = conditions
        key = (c.distance, c.angle, c.incidence, c.reflectance, c.time, c.past_range, *c.covariates.values())
        for known, value in self._recent:
            if len(known) == len(key) and all(a is b for a, b in zip(known, key, strict=True)):
                return value
        value = self._expanded(kernel(self.inputs.standardised(conditions), self.centres), self.alpha)
        if not value.requires_grad:
            self._recent = [(key, value), *self._recent[: KEPT - 1]]
        return value

    def corrected(self, state: State, heads: Mapping[str, Tensor]) -> State:
        """Return the state with the direct echo corrected by given amounts, (n,) each.

        The shift scales with the length of the path, so that a change of the speed of sound applies to it too.
        """
        path = state.direct
        if DETECTION in heads:
            width_db = torch.sqrt(state.width_db**2 + self.sizes.level_sd_db**2)
            probit = torch.clamp(path.level_db / width_db, -CERTAIN, CERTAIN) + heads[DETECTION]
            path = replace(path, level_db=probit * width_db)
        if SHIFT in heads:
            stretch = path.length / torch.clamp(state.conditions.distance, min=1e-3)
            path = replace(path, length=path.length + stretch * heads[SHIFT])
        if SPREAD in heads:
            path = replace(path, spread=self._spread(path, heads[SPREAD]))
        state = state.with_direct(path)
        if EARLY in heads:
            state = state.with_atom(self._tail(state, heads[EARLY], -self.sizes.tails_m[0]))
        return state.with_atom(self._tail(state, heads[LATE], self.sizes.tails_m[1])) if LATE in heads else state

    def _spread(self, path: Path, log_factor: Tensor) -> Tensor:
        """Return the spread for which spread and placement together are wider by a factor.

        Below one, the factor applies to the spread alone, since placement is a property of visits.
        """
        squared = torch.exp(2.0 * torch.clamp(log_factor, -MAX_LOG_SPREAD, MAX_LOG_SPREAD))
        sigma_m, per_metre = self.sizes.jitter
        added = torch.relu(path.spread**2 - sigma_m**2 - (per_metre * path.length) ** 2)
        scaled = (path.spread**2 - added) * squared + self.sizes.placement_m**2 * torch.clamp(squared - 1.0, min=0.0)
        variance = scaled + added
        return torch.sqrt(variance + 1e-18) - 1e-9  # finite gradient at zero

    def _tail(self, state: State, log_odds: Tensor, length_m: float) -> Atom:
        """Return the replacement by a reading exponentially distributed before (negative length) or behind."""
        lag = state.direct.lag.mean(0) if state.direct.lag.ndim == 2 else state.direct.lag
        centre = (state.direct.length + lag) * state.scale + state.offset

        def cdf(edge: Tensor) -> Tensor:
            outside = torch.exp(-torch.relu((edge - centre) / length_m))
            return outside if length_m < 0 else 1.0 - outside

        return Atom(torch.sigmoid(RARE_LOG_ODDS + log_odds), cdf, number(0.0), number(0.0))

    def statement(self) -> str:
        """Return a sentence with the aspects and the inputs."""
        return f"{self.summary} of {', '.join(self.alpha)}, by {', '.join(self.inputs.names)} and level."

    def to_dict(self) -> dict[str, object]:
        """Return the term as plain data."""
        standard = {key: getattr(self.inputs, key).tolist() for key in ("middle", "scale", "low", "high")}
        return {
            "term": self.name,
            "inputs": {"names": list(self.inputs.names), **standard},
            "centres": self.centres.tolist(),
            "alpha": {head: weight.tolist() for head, weight in self.alpha.items()},
            "level_centres": self.level_centres.tolist(),
            "beta": {head: weight.tolist() for head, weight in self.beta.items()},
            **asdict(self.sizes),
        }


class SmoothByPart(Smooth):
    """Corrections with the same inputs, centres and sizes, of which each ping has one.

    Args:
        terms: corrections.
        which: index of the correction of each ping, (n,).
    """

    def __init__(self, terms: Sequence[Smooth], which: Tensor) -> None:
        first = terms[0]
        alpha = {head: torch.stack([term.alpha[head] for term in terms], dim=-1) for head in first.alpha}
        beta = {head: torch.stack([term.beta[head] for term in terms], dim=-1) for head in first.beta}
        super().__init__(first.inputs, first.centres, alpha, first.level_centres, beta, first.sizes)
        self.which = which

    def _expanded(self, covariance: Tensor, weights: Mapping[str, Tensor]) -> Tensor:
        every = torch.tensordot(covariance, torch.stack(list(weights.values()), dim=-1), dims=1)
        return every[torch.arange(len(self.which)), self.which]


def term_of(data: Mapping[str, Any]) -> Smooth:
    """Return the term that `Smooth.to_dict` describes.

    Raises:
        ModelError: a part is missing or is not a finite number.
    """
    try:
        raw = data["inputs"]
        inputs = Inputs(tuple(raw["names"]), *(_finite(raw[key]) for key in ("middle", "scale", "low", "high")))
        alpha, beta = ({str(head): _finite(w) for head, w in data[key].items()} for key in ("alpha", "beta"))
        (early, late), (sigma_m, per_metre) = (map(float, data[name]) for name in ("tails_m", "jitter"))
        centres, level = _finite(data["centres"]), _finite(data["level_centres"])
        fits = all(len(w) == len(centres) for w in alpha.values()) and all(len(w) == len(level) for w in beta.values())
        known = tuple(alpha) == tuple(beta) and set(alpha) <= set(HEADS)
        if not (fits and known and min(early, late) > 0.0 <= min(sigma_m, per_metre)):
            raise ValueError("its parts do not fit together")
        if data["term"] != Smooth.name:
            raise ValueError(f"a term {data['term']!r} is not known")
        sizes = Sizes((early, late), float(data["placement_m"]), float(data["level_sd_db"]), (sigma_m, per_metre))
        return Smooth(inputs, centres, alpha, level, beta, sizes)
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"smooth term: cannot be built from its parameters ({error}); it may be damaged") from None


def _finite(values: list[Any]) -> Tensor:
    tensor = number(values)
    if not bool(torch.isfinite(tensor).all()):
        raise ValueError("a value is not finite")
    return tensor


def level_centres(level: Tensor) -> Tensor:
    """Return centres that cover the levels of a sample, from `level_scale`, (l,)."""
    low, high = float(level.min()), float(level.max())
    steps = max(1, math.ceil((high - low) / LEVEL_STEP))
    return torch.linspace(low, high, steps + 1, dtype=torch.float64)
