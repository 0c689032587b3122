"""Sonars with faults, sonars that differ from the driver's assumption, and a zero offset, a loose contact."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from acquisition import EchoStatus, Ping, Reading
from acquisition.arrays import Bits, Ints
from noise import EchoLaw, SonarModel, load_model
from noise.faults import Faulty, Noise, Short
from noise.law import Floats, SampleOnlyLaw, UniformSource
from noise.learned.persistence import Persistence

TRAINING_FAULTS = (Short(0.05), Noise(0.1, 0.05))  # arbitrary readings; 50 mm scatter; rates chosen here
SEED_WORDS = 8  # 64-bit words taken from a stream to seed the generator of a batch


def with_faults(model: SonarModel) -> Faulty:
    """Return a sonar with `TRAINING_FAULTS`, so that an agent learns not to rely on single readings."""
    return Faulty(model, TRAINING_FAULTS)


class MismatchedLaw(EchoLaw):
    """Law of n pings that draws readings from one law and computes probabilities from another.

    Args:
        actual: law of the readings; drawn for all pings at once from one generator, as the rig requires.
        assumed: law of the probabilities.
    """

    def __init__(self, actual: EchoLaw, assumed: EchoLaw) -> None:
        super().__init__(assumed.distance, assumed.resolution, assumed.max_range)
        self.actual, self.assumed = actual, assumed
        self.has_probabilities = assumed.has_probabilities

    def _arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z) under the assumed law."""
        return self.assumed._arrival(z)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer) under the assumed law, (n,)."""
        return self.assumed.no_answer

    def _sample(self, rng: UniformSource) -> Reading:
        """Draw readings from the actual law."""
        words = rng.random(len(self))[:SEED_WORDS].view(np.uint64)
        return self.actual._sample(np.random.default_rng(words))


@dataclass(frozen=True)
class MismatchedModel:
    """A sonar whose readings do not follow the model that the driver assumes.

    Attributes:
        actual: model of the readings.
        assumed: model from which credence is computed: the one that the driver was trained with.
    """

    actual: SonarModel
    assumed: SonarModel
    remembers: bool = False

    @property
    def resolution(self) -> float:
        """Step of the actual sonar's register, m."""
        return self.actual.resolution

    def law(self, ping: Ping, past: Reading | None = None) -> MismatchedLaw:
        """Return the law of n pings."""
        return MismatchedLaw(self.actual.law(ping), self.assumed.law(ping))


def has_probabilities(sonar: str) -> bool:
    """Return whether a model, by name or folder, has probabilities; the rig can only be sampled."""
    return load_model(sonar).law(Ping.of(distance=[1.0])).has_probabilities


def mismatched(sonar: str, assumed: str | None) -> str | SonarModel:
    """Return a sonar by name or folder, with the driver's assumption where one is named."""
    return sonar if assumed is None else MismatchedModel(load_model(sonar), load_model(assumed))


class ShiftedLaw(EchoLaw):
    """Law of pings whose sensor stands behind the origin of the distances.

    Args:
        law: law at the distances from the sensor.
        distance: distances from the origin, m, (n,).
    """

    def __init__(self, law: EchoLaw, distance: Floats) -> None:
        super().__init__(distance, law.resolution, law.max_range)
        self.law = law
        self.uniform_per_ping = law.uniform_per_ping

    def _arrival(self, z: Floats) -> Floats:
        return self.law._arrival(z)

    def _between(self, low: Floats, high: Floats) -> Floats:
        return self.law._between(low, high)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        return self.law.no_answer

    def _sample(self, rng: UniformSource) -> Reading:
        return self.law._sample(rng)


@dataclass(frozen=True)
class ShiftedModel:
    """A sonar model corrected for a zero offset, which a diagnosis has found.

    Attributes:
        model: model without the offset.
        offset: distance of the sensor behind the origin of the distances, m.
    """

    model: SonarModel
    offset: float
    remembers: bool = False

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    @property
    def persistence(self) -> Persistence | None:
        """Part of the model's spread that persists; None if it has none."""
        return getattr(self.model, "persistence", None)

    def law(self, ping: Ping, past: Reading | None = None) -> ShiftedLaw:
        """Return the law of n pings."""
        return ShiftedLaw(self.model.law(replace(ping, distance=ping.distance + self.offset)), ping.distance)


class LooseLaw(SampleOnlyLaw):
    """Law of n pings of which some have arbitrary readings; it can only be sampled.

    Args:
        law: law of the other pings.
        loose: whether the sonar of each ping has a loose contact, (n,).
        source: number of the sonar of each ping, (n,); all paths of a ping have the same reading.
        share: share of arbitrary readings.
    """

    def __init__(self, law: EchoLaw, loose: Bits, source: Ints, share: float) -> None:
        super().__init__(law.distance, law.resolution, law.max_range)
        self.law, self.loose, self.source, self.share = law, loose, source, share

    def _sample(self, rng: UniformSource) -> Reading:
        """Draw readings; those affected are uniform up to the maximum range."""
        reading = self.law._sample(rng)
        most = int(self.source.max(initial=-1)) + 1
        chance, anything = rng.random(most), (1.0 - rng.random(most)) * self.max_range
        affected = self.loose & (chance[self.source] < self.share)
        steps = np.ceil(anything[self.source] / self.resolution) * self.resolution
        status = np.where(affected, np.uint8(EchoStatus.ECHO), reading.status)
        return Reading(np.where(affected, steps, reading.range), status)


@dataclass(frozen=True)
class LooseContact:
    """A sonar model in which one sonar of each car has a loose contact: on car i that of number i modulo `sonars`.

    Attributes:
        model: model of all sonars.
        share: share of arbitrary readings of that sonar, 0..1.
        sonars: number of sonars of a car.
    """

    model: SonarModel
    share: float
    sonars: int
    remembers: bool = False

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    def law(self, ping: Ping, past: Reading | None = None) -> LooseLaw:
        """Return the law of n pings; their runs are the numbers of the sonars of all cars, car by car."""
        loose = ping.run % self.sonars == (ping.run // self.sonars) % self.sonars
        return LooseLaw(self.model.law(ping), loose, ping.run, self.share)
