"""A sonar by a table over distance, as simulators describe one: Webots's `lookupTable`, Gazebo's Gaussian noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from acquisition import ModelError, Ping, Reading, SettingError
from noise.law import EchoLaw
from noise.model import NormalLaw


@dataclass(frozen=True)
class TableModel:
    """Normal readings whose mean and standard deviation are interpolated linearly between distances.

    Outside the table the values at its ends hold; beyond the maximum range and the maximum incidence there is no echo.

    Args:
        distances: increasing, m, (k,).
        means: mean reading at each distance, m, (k,).
        sigmas: standard deviation at each distance, m, (k,).
        max_range: range beyond which there is no echo, m.
        max_incidence: angle between beam and surface normal beyond which there is no echo, rad.
        resolution: step of the readings, m.

    >>> model = TableModel((0.0, 2.0), (0.1, 2.1), (0.0, 0.0), max_range=3.0)
    >>> float(model.law(Ping.of(1.0)).sample(np.random.default_rng(0)).range[0])
    1.1
    """

    distances: tuple[float, ...]
    means: tuple[float, ...]
    sigmas: tuple[float, ...]
    max_range: float
    max_incidence: float = float(np.pi / 2)
    resolution: float = 0.001
    remembers: bool = False

    def __post_init__(self) -> None:
        """Raise SettingError for columns of unequal length or values outside their limits."""
        sizes = {len(self.distances), len(self.means), len(self.sigmas)}
        if len(sizes) != 1 or sizes == {0}:
            raise SettingError(f"TableModel: expected columns of one length, 1 or more, got {sorted(sizes)}")
        numbers = [*self.distances, *self.means, *self.sigmas, self.max_range, self.max_incidence, self.resolution]
        if not np.all(np.isfinite(numbers)):
            raise SettingError("TableModel: holds a value that is not finite")
        if np.any(np.diff(self.distances) <= 0.0) or self.distances[0] < 0.0:
            raise SettingError("TableModel.distances must be >= 0 m and increase")
        if min(self.sigmas) < 0.0:
            raise SettingError(f"TableModel.sigmas must be >= 0 m, got {min(self.sigmas):g} m")
        for name in ("max_range", "max_incidence", "resolution"):
            if getattr(self, name) <= 0.0:
                raise SettingError(f"TableModel.{name} must be > 0, got {getattr(self, name):g}")

    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the law of n pings."""
        mean, sigma = (np.interp(ping.distance, self.distances, column) for column in (self.means, self.sigmas))
        out = (ping.distance > self.max_range) | (np.abs(ping.incidence) > self.max_incidence)
        return NormalLaw(ping, mean, sigma, out.astype(np.float64), self.resolution, self.max_range)

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain data."""
        columns = {name: list(getattr(self, name)) for name in ("distances", "means", "sigmas")}
        numbers = {name: getattr(self, name) for name in ("max_range", "max_incidence", "resolution")}
        return {"kind": "table", **columns, **numbers}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> TableModel:
        """Build a model from the output of `to_dict`.

        Raises:
            ModelError: a value is missing, not a number, or outside its limits.
        """
        try:
            distances, means, sigmas = (tuple(map(float, data[name])) for name in ("distances", "means", "sigmas"))
            max_range, max_incidence, step = (float(data[k]) for k in ("max_range", "max_incidence", "resolution"))
            return cls(distances, means, sigmas, max_range, max_incidence, step)
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"table model: cannot be built ({error}); it may be damaged") from None
