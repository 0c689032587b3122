"""What differs between episodes besides the street: domain randomisation (Tobin et al. 2017)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np

from acquisition import SettingError
from acquisition.arrays import Floats
from acquisition.limits import Limit, Metres, check_number, check_settings, shown
from sonar_gym.street.street import LEVELS

LEVEL_NAMES = tuple(LEVELS)


class Drawn(NamedTuple):
    """What an episode has drawn.

    Attributes:
        level: number of the level of difficulty in `LEVEL_NAMES`; -1 if none was drawn.
        moved: displacement of each sonar in the frame of the car: m, m, rad, (s, 3).
    """

    level: int
    moved: Floats


@dataclass(frozen=True)
class Randomization:
    """Distributions from which each episode draws, with the generator of its street and before it.

    Attributes:
        street: weights of levels of difficulty; empty for none, and the settings of the environment hold.
        mounts: greatest displacement of each sonar along and across the car, m, and about its axis, deg; uniform and
            independent.
    """

    street: Mapping[str, float] = field(default_factory=dict)
    mounts: tuple[Metres, Annotated[float, Limit(0.0, 360.0, "deg")]] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Raise SettingError for unknown levels, weights that are no distribution, and limits that are negative."""
        check_settings(self, lambda name: f"randomize {name}")
        if not isinstance(self.street, Mapping):
            raise SettingError(f"randomize street: expected a mapping of levels to weights, got {shown(self.street)}")
        for name, weight in self.street.items():
            if name not in LEVELS:
                raise SettingError(f"randomize street {name!r}: unknown level; expected {', '.join(LEVELS)}")
            check_number(f"randomize street {name!r}", weight)
        weights = list(self.street.values())
        if weights and not (min(weights) >= 0.0 and 0.0 < sum(weights) < math.inf):
            raise SettingError(f"randomize street: weights must be >= 0 and one of them > 0, got {weights}")

    def draw(self, rng: np.random.Generator, sonars: int) -> Drawn:
        """Draw for one episode; nothing is taken from `rng` for what is not random."""
        level, moved = -1, np.zeros((sonars, 3))
        if self.street:
            share = np.array(list(self.street.values()), dtype=np.float64)
            level = LEVEL_NAMES.index(list(self.street)[rng.choice(len(share), p=share / share.sum())])
        if any(self.mounts):
            limits = np.array([self.mounts[0], self.mounts[0], math.radians(self.mounts[1])])
            moved = limits * rng.uniform(-1.0, 1.0, (sonars, 3))
        return Drawn(level, moved)
