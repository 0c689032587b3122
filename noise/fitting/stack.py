"""A physical model and its nuisances as plain numbers, effect id -> parameter -> value: what fits move about."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from noise.effects import CATALOGUE, Effect, Parameter
from noise.fitting.batch import Batch
from noise.fitting.visit_effects import VisitEffects, direct_median, law_of
from noise.law import Floats
from noise.physical import PhysicalModel

Values = dict[str, dict[str, float]]
Key = tuple[str, str]
CELLS = "cells"
JITTER = "travel_time_jitter"
SPREAD = ((JITTER, "sigma_m"), (JITTER, "per_metre"), (CELLS, "placement_m"))
LINK = (CELLS, "link")
SHARED = ((CELLS, "carry"), (CELLS, "sharing"), (CELLS, "kernel_m"), (CELLS, "hearing"), LINK)
NUISANCES: tuple[Key, ...] = (*SPREAD, *SHARED)


@dataclass(frozen=True)
class Stack:
    """A physical model and its nuisances as numbers.

    Attributes:
        values: effect id -> parameter -> value; "cells" holds the nuisances of `VisitEffects`.
        resolution, max_range: of the register, m.
        extra: effects that are known beyond the catalogue (the flexible part of an emulator), by id.
    """

    values: Values
    resolution: float = 0.001
    max_range: float = 11.008
    extra: Mapping[str, type[Effect]] = field(default_factory=dict)

    @classmethod
    def of(cls, model: PhysicalModel) -> Stack:
        """Take the numbers out of a model."""
        extra = {effect.name: type(effect) for effect in model.effects if effect.name not in CATALOGUE}
        values = {effect.name: effect.values for effect in model.effects}
        return cls(values, model.resolution, model.max_range, extra)

    @cached_property
    def known(self) -> dict[str, type[Effect]]:
        """Every effect that the stack may hold, by id."""
        return {**CATALOGUE, **self.extra, CELLS: VisitEffects}

    def parameter(self, key: Key) -> Parameter:
        """Return what is known of a parameter."""
        return next(p for p in self.known[key[0]].parameters if p.name == key[1])

    def get(self, key: Key) -> float:
        """Return a parameter's value; its null value where the effect is absent."""
        return self.values.get(key[0], {}).get(key[1], self.parameter(key).null)

    def put(self, keys: Sequence[Key], numbers: Iterable[float]) -> Stack:
        """Return the stack with some parameters at other values, clipped to their bounds."""
        values = {name: dict(inner) for name, inner in self.values.items()}
        for key, number in zip(keys, numbers, strict=True):
            p = self.parameter(key)
            values.setdefault(key[0], {})[key[1]] = float(np.clip(number, min(p.low, p.null), max(p.high, p.null)))
        return replace(self, values=values)

    def at(self, values: Mapping[Key, float]) -> Stack:
        """Return the stack with these parameters at these values, clipped to their bounds."""
        return self.put(list(values), values.values())

    def without(self, name: str) -> Stack:
        """Return the stack without an effect."""
        return replace(self, values={k: v for k, v in self.values.items() if k != name})

    def build(self, keys: Sequence[Key] = (), numbers: Tensor | None = None) -> tuple[PhysicalModel, VisitEffects]:
        """Return model and nuisances; the parameters at `keys` are taken from a tensor, so gradients flow."""
        values: dict[str, dict[str, float | Tensor]] = {name: dict(v) for name, v in self.values.items()}
        for k, key in enumerate(keys):
            assert numbers is not None
            values.setdefault(key[0], {})[key[1]] = numbers[k]
        cells = VisitEffects(**values.pop(CELLS, {}))
        effects = [self.known[name](**inner) for name, inner in values.items()]
        return PhysicalModel(effects, self.resolution, self.max_range), cells

    def expected(self, batch: Batch) -> Floats:
        """Return the median reading that the law expects of each ping of a batch, m, (n,)."""
        return self.model.law(batch.ping, batch.past).quantile(0.5)

    def direct(self, batch: Batch) -> tuple[Floats, Floats]:
        """Return where the law expects the target's own echo to be read, m, and its variance, m^2, (n,) each.

        Unlike `expected` it leaves aside what a law repeats of the reading before, and whatever else may answer.
        """
        with torch.no_grad():
            middle, variance = direct_median(law_of(self.model, batch))
        return middle.numpy(), variance.numpy()

    @property
    def model(self) -> PhysicalModel:
        """The model alone."""
        return self.build()[0]
