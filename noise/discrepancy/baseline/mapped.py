"""Quantile mapping: what a recording shows beyond a law acts on given readings, such as those of the simulator itself.

A reading z that the law F places at u = F(z) becomes the reading that the recalibrated law G places there, so that
G(z') = F(z). Readings keep their order: those that are long for the law stay long. A silent ping has the transforms
between the law's probability of an echo and one, and may become an echo where the recalibrated law has more of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import ModelError, Ping, Reading
from acquisition.arrays import Floats
from acquisition.brief import brief
from noise.discrepancy.baseline.recalibration import Recalibrated, RecalibratedLaw
from noise.law import EchoLaw
from noise.model import SonarModel


class MappedLaw(EchoLaw):
    """Readings mapped from one law to its recalibration.

    Attributes:
        given: law of the readings before the map.
        after: the recalibrated law.
    """

    uniform_per_ping = True

    def __init__(self, given: EchoLaw, after: RecalibratedLaw, resolution: float) -> None:
        super().__init__(given.distance, resolution, given.max_range)
        self.given, self.after = given, after

    def _arrival(self, z: Floats) -> Floats:
        before = self.after.law
        u, echo = self.after._arrival(z), before.echo
        silent = np.clip(1.0 - echo - before.no_answer, 0.0, 1.0)
        heard = np.divide(np.clip(u - echo, 0.0, silent), silent, out=np.zeros_like(u), where=silent > 0.0)
        own = np.where(u >= echo, np.inf, _inverse(before, np.minimum(u, echo)))
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
    """A model whose readings are mapped from a law to its recalibration.

    Attributes:
        model: of the readings before the map.
        after: the recalibrated law, with the law before it.
    """

    __repr__ = brief

    model: SonarModel
    after: Recalibrated

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading."""
        return self.model.remembers or self.after.remembers

    def law(self, ping: Ping, past: Reading | None = None) -> MappedLaw:
        """Return the law of n pings, given the previous reading of each."""
        return MappedLaw(self.model.law(ping, past), self.after.law(ping, past), self.resolution)

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data."""
        model: Any = self.model
        return {"kind": "mapped", "model": model.to_dict(), "after": self.after.to_dict()}

    @classmethod
    def load(cls, folder: Path, data: dict[str, Any], load_kind: Callable[[Path, object], SonarModel]) -> Mapped:
        """Load a saved model; `load_kind` loads the models inside.

        Raises:
            ModelError: the second of them is no recalibrated law.
        """
        after = load_kind(folder, data["after"])
        if not isinstance(after, Recalibrated):
            kind = type(after).__name__
            raise ModelError(f"{folder / 'model.json'}: `after` is a {kind}, expected a recalibrated law")
        return cls(load_kind(folder, data["model"]), after)
