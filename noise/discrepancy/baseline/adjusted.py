"""A law changed by functions of a ping that have no formula, which are sums of trees.

They move echoes, spread those of the target, lose and add echoes, and put some before or behind the target instead,
where such echoes of a recording were.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from acquisition import ModelError, Ping, Reading
from acquisition.arrays import Floats
from acquisition.brief import brief
from noise.discrepancy.baseline.forest_law import LEVELS, N_LEVELS, QuantileLaw
from noise.discrepancy.baseline.similarity import Leaves
from noise.effects.base import target_tolerance
from noise.law import EchoLaw
from noise.model import SonarModel

SHIFT, SPREAD, LOST, GAINED, EARLY, LATE = PARTS = ("shift", "spread", "lost", "gained", "early", "late")
SCALES = (0.2, 5.0)  # of a target's echoes, relative to the law's; chosen here
# what the range z of an echo of another reflector than the target, which is at d, may have in common with other such
# echoes: itself, the distance from the target, or its ratio to that of the target
FORMS: dict[str, tuple[Callable[[Floats, Floats], Floats], Callable[[Floats, Floats], Floats]]] = {
    "range": (lambda z, d: z, lambda x, d: x),
    "offset": (lambda z, d: z - d, lambda x, d: x + d),
    "ratio": (lambda z, d: z / d, lambda x, d: x * d),
}

Amounts = Mapping[str, Floats]  # by part, (n,): m for the shift, relative for the others


@dataclass(frozen=True, eq=False)
class Outliers:
    """Where echoes of other reflectors than the target are.

    Attributes:
        form: what they have in common, of `FORMS`.
        value: its quantiles at `LEVELS`, ascending, (`N_LEVELS`,).
    """

    form: str
    value: Floats

    @classmethod
    def of(cls, range_: Floats, distance: Floats) -> Outliers:
        """Return where echoes are, in the form in which they scatter least, given ranges and distances, m, (n,)."""

        def scatter(form: str) -> float:
            common, back = FORMS[form]
            middle = np.full_like(distance, np.median(common(range_, distance)))
            return float(np.mean(np.abs(np.subtract(range_, back(middle, distance)))))

        form = min(FORMS, key=scatter)
        return cls(form, np.quantile(FORMS[form][0](range_, distance), LEVELS))

    def law(self, law: EchoLaw) -> QuantileLaw:
        """Return the law of such an echo for each ping of another law."""
        every = np.broadcast_arrays(self.value[None, :], law.distance[:, None])
        knots = FORMS[self.form][1](*every)
        echo = np.ones(len(law))
        return QuantileLaw(law.distance, echo, np.maximum(knots, law.resolution), law.resolution, law.max_range)

    def to_dict(self) -> dict[str, object]:
        """Return it as plain data."""
        return {"form": self.form, "value": self.value.tolist()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Outliers:
        """Return what `to_dict` describes.

        Raises:
            KeyError, TypeError, ValueError: a part is missing or not valid.
        """
        found = cls(str(data["form"]), np.asarray(data["value"], dtype=np.float64))
        ordered = (
            found.value.shape == (N_LEVELS,) and np.isfinite(found.value).all() and (np.diff(found.value) >= 0).all()
        )
        if found.form not in FORMS or not ordered:
            raise ValueError("where echoes of other reflectors are is not valid")
        return found


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
    """A law whose echoes are moved, of which those of the target are spread, and some lost, gained or elsewhere.

    Attributes:
        law: of n pings.
        shift: of its echoes, m, (n,).
        scale: width of the target's echoes relative to the law's, (n,).
        heard: probability of an echo, (n,).
        other: shares of echoes that are before and behind the target instead, (n,), each with their law.
    """

    uniform_per_ping = True

    def __init__(self, law: EchoLaw, amount: Amounts, outliers: Mapping[str, Outliers]) -> None:
        super().__init__(law.distance, law.resolution, law.max_range)
        none = np.zeros(len(law))
        self.law, self.shift = law, amount.get(SHIFT, none)
        self.scale = np.clip(1.0 + amount.get(SPREAD, none), *SCALES)
        self._echo, answer = law.echo, 1.0 - law.no_answer
        kept = self._echo * (1.0 - amount.get(LOST, none))
        self.heard = np.clip(kept + (answer - kept) * amount.get(GAINED, none), 0.0, answer)
        self.other = [(np.clip(amount[name], 0.0, 1.0), each.law(law)) for name, each in outliers.items()]
        self._middle, self._reach = law.quantile(0.5), target_tolerance(law.distance)

    def _arrival(self, z: Floats) -> Floats:
        moved = z - self.shift
        off = moved - self._middle
        narrowed = self._middle + np.clip(off / self.scale, -self._reach, self._reach)
        own = self.law._arrival(np.where(np.abs(off) < self._reach, narrowed, moved))
        arrival = np.divide(own, self._echo, out=np.zeros_like(own), where=self._echo > 0.0)
        for share, law in self.other:
            arrival = arrival + share * (law._arrival(z) - arrival)
        return arrival * self.heard

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        return self.law.no_answer


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A model with echoes moved, spread, lost, gained and elsewhere.

    Attributes:
        model: the model.
        parts: functions of a ping, by name.
        outliers: where the echoes before and behind the target are, if there are such parts.
    """

    __repr__ = brief

    model: SonarModel
    parts: Mapping[str, Boosted]
    outliers: Mapping[str, Outliers] = field(default_factory=dict)

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
        amount = {name: part(ping, past) for name, part in self.parts.items()}
        return AdjustedLaw(self.model.law(ping, past), amount, self.outliers)

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data.

        Raises:
            ModelError: the inner model cannot be saved.
        """
        inner: Any = self.model
        if not hasattr(inner, "to_dict"):
            raise ModelError(f"Adjusted: a {type(inner).__name__} cannot be saved; it has no to_dict()")
        parts = {name: part.to_dict() for name, part in self.parts.items()}
        outliers = {name: each.to_dict() for name, each in self.outliers.items()}
        return {"kind": "adjusted", "model": inner.to_dict(), "parts": parts, "outliers": outliers}

    @classmethod
    def load(cls, folder: Any, data: dict[str, Any], load_kind: Any) -> Adjusted:
        """Load a saved model; `load_kind` loads the inner model.

        Raises:
            ModelError: a part is missing or does not fit the others.
        """
        try:
            parts = {name: Boosted.from_dict(part) for name, part in data["parts"].items()}
            outliers = {name: Outliers.from_dict(each) for name, each in data["outliers"].items()}
            if unknown := parts.keys() - set(PARTS):
                raise ValueError(f"it knows no {', '.join(sorted(unknown))}")
            if missing := {EARLY, LATE} & parts.keys() - outliers.keys():
                raise ValueError(f"where the echoes are is missing: {', '.join(sorted(missing))}")
        except (KeyError, TypeError, ValueError) as problem:
            raise ModelError(f"model: cannot be built from its parts ({problem}); it may be damaged") from None
        return cls(load_kind(folder, data["model"]), parts, outliers)
