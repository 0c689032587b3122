"""A physical model and its nuisance parameters as plain numbers: effect id -> parameter -> value."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from acquisition.arrays import Floats, Ints
from noise.effects import CATALOGUE, Effect, Parameter
from noise.effects.state import number
from noise.fitting.batch import Batch
from noise.fitting.empirical import EmpiricalModel, PlacementScatter
from noise.fitting.smooth import Smooth, SmoothByPart
from noise.fitting.visit_effects import VisitEffects, direct_median, law_of, placement_scatter
from noise.physical import PhysicalModel

Values = dict[str, dict[str, float]]
Key = tuple[str, str]
VISITS = "visits"
JITTER = "travel_time_jitter"
PLACEMENT = (VISITS, "placement_m")
SPREAD = ((JITTER, "sigma_m"), (JITTER, "per_metre"), PLACEMENT)
LEVEL_SD = (VISITS, "level_sd_db")
SIMULATION_CORRELATION = (VISITS, "simulation_correlation")
SHARED = (
    (VISITS, "ping_correlation"),
    (VISITS, "urn_weight"),
    (VISITS, "urn_width_m"),
    LEVEL_SD,
    SIMULATION_CORRELATION,
)
STEPWISE = ("step_m", "unit_m")  # parameters that a law has no derivative in
NUISANCES: tuple[Key, ...] = (*SPREAD, *SHARED)
OF_A_KIND = tuple(key for key in NUISANCES if key != SIMULATION_CORRELATION)  # alike in recordings of such a sonar
FAMILIAR_SD = float(np.log(2.0))  # of the ratio of a nuisance parameter in two recordings of one kind; chosen here


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Smooth corrections that were each fitted without one part of the conditions.

    Readings look better described by a law that was fitted to them than others do. Two files are therefore compared
    under laws that saw neither.

    Attributes:
        terms: one for each part.
        part: of each condition of the fitted readings, by index; -1 for those that were not fitted.
    """

    terms: tuple[Smooth, ...]
    part: Ints

    def of(self, batch: Batch) -> Ints:
        """Return the part of each ping of a batch of the fitted recording, (n,)."""
        known = batch.condition < len(self.part)
        return np.where(known, self.part[np.where(known, batch.condition, 0)], -1)


@dataclass(frozen=True)
class Stack:
    """A physical model and its nuisance parameters as numbers.

    Attributes:
        values: effect id -> parameter -> value; "visits" holds those of `VisitEffects`.
        resolution, max_range: of the register, m.
        terms: smooth corrections without parameters, at most one of each id.
        bounds: parameters with narrower bounds than the catalogue's.
        left_out: the smooth correction without each part of the readings it was fitted to.
        familiar: nuisance parameters in another recording of such a sonar, the centres of their priors.
    """

    values: Values
    resolution: float = 0.001
    max_range: float = 11.008
    terms: tuple[Smooth, ...] = ()
    bounds: Mapping[Key, Parameter] = field(default_factory=dict)
    left_out: LeftOut | None = None
    familiar: Mapping[Key, float] = field(default_factory=dict)

    @classmethod
    def of(cls, model: PhysicalModel) -> Stack:
        """Return the stack of a model."""
        terms = tuple(effect for effect in model.effects if isinstance(effect, Smooth))
        values = {effect.name: effect.values for effect in model.effects if not isinstance(effect, Smooth)}
        return cls(values, model.resolution, model.max_range, terms)

    @cached_property
    def known(self) -> dict[str, type[Effect]]:
        """All effects that a stack can contain, by id."""
        return {**CATALOGUE, VISITS: VisitEffects, PlacementScatter.name: PlacementScatter}

    def parameter(self, key: Key) -> Parameter:
        """Return the description of a parameter."""
        return self.bounds.get(key) or next(p for p in self.known[key[0]].parameters if p.name == key[1])

    def get(self, key: Key) -> float:
        """Return a parameter's value; its null value where the effect is absent."""
        return self.values.get(key[0], {}).get(key[1], self.parameter(key).null)

    def put(self, keys: Sequence[Key], numbers: Iterable[float]) -> Stack:
        """Return the stack with parameters at new values, clipped to their bounds."""
        values = {name: dict(inner) for name, inner in self.values.items()}
        for key, value in zip(keys, numbers, strict=True):
            p = self.parameter(key)
            values.setdefault(key[0], {})[key[1]] = float(np.clip(value, min(p.low, p.null), max(p.high, p.null)))
        return replace(self, values=values)

    def at(self, values: Mapping[Key, float]) -> Stack:
        """Return the stack with parameters at new values, clipped to their bounds."""
        return self.put(list(values), values.values())

    def without(self, name: str) -> Stack:
        """Return the stack without an effect."""
        return replace(self, values={k: v for k, v in self.values.items() if k != name})

    def with_term(self, term: Smooth) -> Stack:
        """Return the stack with a smooth correction, which replaces an older one of the same id."""
        return replace(self, terms=(*(old for old in self.terms if old.name != term.name), term))

    def by_part(self, part: Ints) -> Stack:
        """Return the stack in which each ping has the smooth correction that was fitted without its part, (n,).

        Pings of part -1 have the correction that was fitted to all.
        """
        if self.left_out is None or part.max() < 0:
            return self
        return self.with_term(SmoothByPart([*self.terms, *self.left_out.terms], torch.from_numpy(part + 1)))

    def without_term(self, name: str) -> Stack:
        """Return the stack without a smooth correction."""
        return replace(self, terms=tuple(term for term in self.terms if term.name != name))

    def build(self, keys: Sequence[Key] = (), numbers: Tensor | None = None) -> tuple[PhysicalModel, VisitEffects]:
        """Return model and visit effects; the parameters at `keys` come from a tensor, for gradients."""
        values: dict[str, dict[str, float | Tensor]] = {name: dict(v) for name, v in self.values.items()}
        for k, key in enumerate(keys):
            assert numbers is not None
            values.setdefault(key[0], {})[key[1]] = numbers[k]
        visits = VisitEffects.unchecked(values.pop(VISITS, {}))
        effects = [self.known[name].unchecked(inner) for name, inner in values.items()]
        kind = EmpiricalModel if self.terms else PhysicalModel
        return kind([*effects, *self.terms], self.resolution, self.max_range), visits

    def log_prior(self, keys: Sequence[Key], numbers: Tensor) -> Tensor:
        """Return the log prior of parameters, nats, up to a constant: two recordings of one kind scatter alike.

        Few visits say little of their scatter, and one that is free explains any difference. The prior is log-normal
        above the size at which the parameter begins to matter, which is its starting value.
        """
        total = number(0.0)
        for key, value in zip(keys, numbers, strict=True):
            if key in self.familiar:
                floor = self.parameter(key).starts[0]
                ratio = (value + floor) / (self.familiar[key] + floor)
                total = total - 0.5 * (torch.log(ratio) / FAMILIAR_SD) ** 2
        return total

    def log_size_prior(self, base: Stack, names: Iterable[str]) -> float:
        """Return the log prior of the sizes of effects relative to a base: Cauchy, with the `typical` size as scale."""
        parameters = [(name, p) for name in names for p in self.known[name].parameters if p.typical > 0]
        ratios = [(self.get((name, p.name)) - base.get((name, p.name))) / p.typical for name, p in parameters]
        return -float(np.sum(np.log1p(np.square(ratios))))

    def log_nuisance_prior(self) -> float:
        """Return the log prior of the nuisance parameters as they are, nats."""
        return float(self.log_prior(NUISANCES, number([self.get(key) for key in NUISANCES])))

    def is_the_target(self, name: str, batch: Batch) -> bool:
        """Return whether the fixed reading of an effect is that of the target in every ping: one that never moved."""
        fixed = self.known[name].fixed_range
        return bool(fixed) and bool(np.all(np.abs(self.get((name, fixed)) - batch.ping.distance) < batch.reach))

    def expected(self, batch: Batch) -> Floats:
        """Return the median of the law of each ping, m, (n,)."""
        return self.model.law(batch.ping, batch.past).quantile(0.5)

    def direct(self, batch: Batch) -> tuple[Floats, Floats]:
        """Return median, m, and variance, m^2, of the direct path's reading, (n,) each.

        Unlike `expected`, it excludes repeated readings and the echoes of other reflectors.
        """
        with torch.no_grad():
            middle, variance = direct_median(law_of(self.model, batch))
        return middle.numpy(), variance.numpy()

    @property
    def single_ping_model(self) -> EmpiricalModel:
        """The model of a ping whose visit has no other readings: the scatter of placements is included."""
        model, visits = self.build()
        scatter = placement_scatter(float(visits.placement_m))
        placement = PlacementScatter(sigma_m=scatter, level_sd_db=float(visits.level_sd_db))
        return EmpiricalModel([*model.effects, placement], self.resolution, self.max_range)

    @property
    def effects(self) -> Values:
        """Parameters of the effects of the catalogue, without nuisance parameters of visits."""
        return {name: values for name, values in self.values.items() if name in CATALOGUE}

    @property
    def model(self) -> PhysicalModel:
        """The model without nuisance parameters of visits."""
        return self.build()[0]
