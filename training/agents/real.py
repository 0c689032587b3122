"""Sonars that are not what the driver takes them for, and sonars corrected by what a diagnosis found."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from acquisition import Ping, Reading
from noise import EchoLaw, SonarModel, load_model
from noise.law import Floats

WORDS = 8  # numbers of a stream from which the generator of a batch is made


class RealLaw(EchoLaw):
    """What is heard of n pings, drawn from one law; what is believed of them, from another.

    Args:
        heard: is drawn from, for all pings at once and from one generator: a rig draws in ways of its own.
        believed: tells probabilities.
    """

    def __init__(self, heard: EchoLaw, believed: EchoLaw) -> None:
        super().__init__(believed.distance, believed.resolution, believed.max_range)
        self.heard, self.believed = heard, believed
        self.has_probabilities = believed.has_probabilities

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z), as it is believed."""
        return self.believed.arrival(z)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), as it is believed, (n,)."""
        return self.believed.no_answer

    def sample(self, rng: np.random.Generator) -> Reading:
        """Draw what is heard."""
        words = rng.random(len(self))[:WORDS].view(np.uint64)
        return self.heard.sample(np.random.default_rng(words))


@dataclass(frozen=True)
class RealModel:
    """A sonar that a driver mistakes for another.

    Attributes:
        heard: where readings come from.
        believed: what their credence is reckoned by: the model with which the driver was trained.
    """

    heard: SonarModel
    believed: SonarModel
    remembers: bool = False

    @property
    def resolution(self) -> float:
        """Step of the register that is heard, m."""
        return self.heard.resolution

    def law(self, ping: Ping, past: Reading | None = None) -> RealLaw:
        """Return the law of n pings."""
        return RealLaw(self.heard.law(ping), self.believed.law(ping))


def tells(sonar: str) -> bool:
    """Return whether a sonar knows probabilities, or can only be drawn from."""
    return load_model(sonar).law(Ping.of(distance=[1.0])).has_probabilities


def heard_as(sonar: str, believed: str | None) -> str | SonarModel:
    """Return a sonar by its name or folder; one that is taken for another, where another is named."""
    return sonar if believed is None else RealModel(load_model(sonar), load_model(believed))


class MovedLaw(EchoLaw):
    """The law of pings whose sensor stands behind the place that distances are counted from.

    Args:
        law: of the distances as the sensor has them.
        distance: as they are counted, m, (n,).
    """

    def __init__(self, law: EchoLaw, distance: Floats) -> None:
        super().__init__(distance, law.resolution, law.max_range)
        self.law = law

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        return self.law.arrival(z)

    def between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high])."""
        return self.law.between(low, high)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        return self.law.no_answer

    def sample(self, rng: np.random.Generator) -> Reading:
        """Draw what is heard."""
        return self.law.sample(rng)


@dataclass(frozen=True)
class MovedModel:
    """A sonar corrected by a diagnosis that found its zero elsewhere.

    Attributes:
        model: that knows nothing of it.
        metres: how far the sensor stands behind the place that distances are counted from.
    """

    model: SonarModel
    metres: float
    remembers: bool = False

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    def law(self, ping: Ping, past: Reading | None = None) -> MovedLaw:
        """Return the law of n pings."""
        return MovedLaw(self.model.law(replace(ping, distance=ping.distance + self.metres)), ping.distance)
