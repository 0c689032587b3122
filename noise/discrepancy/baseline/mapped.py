"""Quantile mapping: what a recording shows beyond a simulation acts on the simulator's own readings.

A reading z that the law F of the simulation places at u = F(z) becomes the reading that the law G of the recording
places there, so that G(z') = F(z). Readings keep their order: those that are long for the simulation stay long. A
silent ping has the transforms between the probability of an echo and one, and may become an echo where G has more of
them. Both laws are recalibrated, each by its own readings, so that an error that they share moves no reading.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import Ping, Reading
from acquisition.arrays import Floats
from acquisition.brief import brief
from noise.law import EchoLaw
from noise.model import SonarModel

PARTS = ("model", "before", "after")


class MappedLaw(EchoLaw):
    """Readings mapped from one law to another.

    Attributes:
        given: law of the readings before the map.
        before, after: laws between which they are mapped, of the same n pings.
    """

    uniform_per_ping = True

    def __init__(self, given: EchoLaw, before: EchoLaw, after: EchoLaw, resolution: float) -> None:
        super().__init__(given.distance, resolution, given.max_range)
        self.given, self.before, self.after = given, before, after

    def _arrival(self, z: Floats) -> Floats:
        u, echo, silent = self.after._arrival(z), self.before.echo, self.before.no_echo
        heard = np.divide(np.clip(u - echo, 0.0, silent), silent, out=np.zeros_like(u), where=silent > 0.0)
        own = np.where(u >= echo, np.inf, _inverse(self.before, np.minimum(u, echo)))
        return self.given._arrival(own) + self.given.no_echo * heard

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        return self.given.no_answer


def _inverse(law: EchoLaw, u: Floats) -> Floats:
    """Return the exact range up to which a law has an echo with probability u, m, linear within a step."""
    step = np.clip(law._invert(u), 1, law.last_step)
    low, high = law._cdf_step(step - 1), law._cdf_step(step)
    within = np.divide(u - low, high - low, out=np.ones_like(u), where=high > low)
    return (step - 0.5 + np.clip(within, 0.0, 1.0)) * law.resolution


@dataclass(frozen=True, eq=False)
class Mapped:
    """A model whose readings are mapped from one law to another.

    Attributes:
        model: of the readings before the map.
        before, after: models between whose laws they are mapped.
    """

    __repr__ = brief

    model: SonarModel
    before: SonarModel
    after: SonarModel

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading."""
        return any(each.remembers for each in (self.model, self.before, self.after))

    def law(self, ping: Ping, past: Reading | None = None) -> MappedLaw:
        """Return the law of n pings, given the previous reading of each."""
        given, before, after = (each.law(ping, past) for each in (self.model, self.before, self.after))
        return MappedLaw(given, before, after, self.resolution)

    def to_dict(self) -> dict[str, object]:
        """Return the models as plain data."""
        models: dict[str, Any] = {name: getattr(self, name) for name in PARTS}
        return {"kind": "mapped", **{name: model.to_dict() for name, model in models.items()}}

    @classmethod
    def load(cls, folder: Path, data: dict[str, Any], load_kind: Callable[[Path, object], SonarModel]) -> Mapped:
        """Load a saved model; `load_kind` loads the models inside."""
        return cls(*(load_kind(folder, data[name]) for name in PARTS))
