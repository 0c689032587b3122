"""A law with echoes moved, spread, lost and gained by functions of a ping that have no formula: sums of trees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquisition import ModelError, Ping, Reading
from acquisition.arrays import Floats
from acquisition.brief import brief
from noise.discrepancy.baseline.similarity import Leaves
from noise.effects.base import target_tolerance
from noise.law import EchoLaw
from noise.model import SonarModel

SHIFT, SPREAD, LOST, GAINED = PARTS = ("shift", "spread", "lost", "gained")
SCALES = (0.2, 5.0)  # of a target's echoes, relative to the law's; chosen here

Amounts = Mapping[str, Floats]  # by part, (n,): m for the shift, relative for the others


@dataclass(frozen=True, eq=False)
class Boosted(Leaves):
    """A sum of trees.

    Attributes:
        value: that a node adds where it is a leaf, (nodes,).
    """

    value: Floats

    def __call__(self, ping: Ping, past: Reading | None) -> Floats:
        """Return the value of n pings, the mean of those at recorded times where theirs is another, (n,)."""
        reached = self.reached(ping, past)
        return np.asarray(self.value[reached].sum(axis=1) * len(self.trees.root) / reached.shape[1])

    def to_dict(self) -> dict[str, object]:
        """Return the trees as plain data."""
        return {**super().to_dict(), "value": self.value.tolist()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Boosted:
        """Return what `to_dict` describes.

        Raises:
            KeyError, TypeError, ValueError: a part is missing or does not fit the others.
        """
        found = cls(*cls.given(data), np.asarray(data["value"], dtype=np.float64))
        found.check()
        if found.value.shape != found.trees.feature.shape or not np.isfinite(found.value).all():
            raise ValueError("the values of its leaves are missing or not finite")
        return found


class AdjustedLaw(EchoLaw):
    """A law whose echoes are moved, of which those of the target are spread, and some are lost or gained.

    Attributes:
        law: of n pings.
        shift: of its echoes, m, (n,).
        scale: width of the target's echoes relative to the law's, (n,).
        heard: probability of an echo, (n,).
    """

    uniform_per_ping = True

    def __init__(self, law: EchoLaw, amount: Amounts) -> None:
        super().__init__(law.distance, law.resolution, law.max_range)
        none = np.zeros(len(law))
        self.law, self.shift = law, amount.get(SHIFT, none)
        self.scale = np.clip(1.0 + amount.get(SPREAD, none), *SCALES)
        self._echo, answer = law.echo, 1.0 - law.no_answer
        kept = self._echo * (1.0 - amount.get(LOST, none))
        self.heard = np.clip(kept + (answer - kept) * amount.get(GAINED, none), 0.0, answer)
        self._middle, self._reach = law.quantile(0.5), target_tolerance(law.distance)

    def _arrival(self, z: Floats) -> Floats:
        moved = z - self.shift
        off = moved - self._middle
        narrowed = self._middle + np.clip(off / self.scale, -self._reach, self._reach)
        own = self.law._arrival(np.where(np.abs(off) < self._reach, narrowed, moved))
        return np.divide(own * self.heard, self._echo, out=np.zeros_like(own), where=self._echo > 0.0)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        return self.law.no_answer


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A model with echoes moved, spread, lost and gained.

    Attributes:
        model: the model.
        parts: functions of a ping, by name.
    """

    __repr__ = brief

    model: SonarModel
    parts: Mapping[str, Boosted]

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading."""
        return self.model.remembers or any(part.remembers for part in self.parts.values())

    def law(self, ping: Ping, past: Reading | None = None) -> AdjustedLaw:
        """Return the law of n pings, given the previous reading of each."""
        return AdjustedLaw(self.model.law(ping, past), {name: part(ping, past) for name, part in self.parts.items()})

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data.

        Raises:
            ModelError: the inner model cannot be saved.
        """
        inner: Any = self.model
        if not hasattr(inner, "to_dict"):
            raise ModelError(f"Adjusted: a {type(inner).__name__} cannot be saved; it has no to_dict()")
        parts = {name: part.to_dict() for name, part in self.parts.items()}
        return {"kind": "adjusted", "model": inner.to_dict(), "parts": parts}

    @classmethod
    def load(cls, folder: Any, data: dict[str, Any], load_kind: Any) -> Adjusted:
        """Load a saved model; `load_kind` loads the inner model.

        Raises:
            ModelError: a part is missing or does not fit the others.
        """
        try:
            parts = {name: Boosted.from_dict(part) for name, part in data["parts"].items()}
            if unknown := parts.keys() - set(PARTS):
                raise ValueError(f"it knows no {', '.join(sorted(unknown))}")
        except (KeyError, TypeError, ValueError) as problem:
            raise ModelError(f"model: cannot be built from its parts ({problem}); it may be damaged") from None
        return cls(load_kind(folder, data["model"]), parts)
