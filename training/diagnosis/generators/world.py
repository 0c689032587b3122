"""A sonar with its register and its link, and causes that are planted in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from acquisition import EchoStatus, Ping, Reading, Recording
from acquisition.arrays import Bits, Floats, Ints

Rng = np.random.Generator
Operator = Callable[[Floats, Ping, Rng], Floats]  # on readings, m, 0 for no echo, given what is logged
Region = Mapping[str, tuple[float, float]]
FULL_SCALE_M = 11.0  # largest reading of the sonars modelled here: 64 ms of listening
STEPS_M = {"mm": 0.001, "cm": 0.01, "inch": 0.0254, "us": 0.01 / 58.0}  # register units, 58 us per cm
LARGEST_M = (2**16 - 1) * STEPS_M["inch"]  # reading that 16 bits hold in the coarsest unit


class Sonar(Protocol):
    """A sonar in its surroundings."""

    def read(self, ping: Ping, rng: Rng) -> tuple[Ping, Floats]:
        """Return n pings as they are logged, and readings before the register, m, (n,), 0 for no echo."""
        ...


@dataclass(frozen=True)
class Register:
    """Register of ranges.

    Attributes:
        step_m: unit of the register, m.
        truncated: whether ranges are truncated, instead of rounded, to whole steps.
    """

    step_m: float = 0.001
    truncated: bool = False

    @classmethod
    def draw(cls, rng: Rng) -> Register:
        """Return a register in mm, cm, inch or us, rounded or, as in integer arithmetic, truncated."""
        return cls(STEPS_M[str(rng.choice(list(STEPS_M)))], bool(rng.random() < 0.5))

    def __call__(self, value: Floats) -> Floats:
        """Return readings, m, as the register holds them; an echo reads at least one step."""
        count = np.floor(value / self.step_m + 1e-9) if self.truncated else np.rint(value / self.step_m)
        return np.where(value > 0.0, np.clip(count, 1.0, LARGEST_M // self.step_m) * self.step_m, 0.0)


@dataclass(frozen=True)
class World:
    """A sonar, and what happens to its readings until they are logged.

    Attributes:
        sonar: returns readings.
        register: of ranges.
        operators: faults before the register.
        link: faults between register and host.
        unanswered: share of pings that the sensor does not answer.
    """

    sonar: Any  # a Sonar; the families change its fields by name
    register: Register = field(default_factory=Register)
    operators: tuple[Operator, ...] = ()
    link: tuple[Operator, ...] = ()
    unanswered: float = 0.0

    def record(self, ping: Ping, rng: Rng, missing: tuple[str, ...] = ()) -> Recording:
        """Return the recording of n pings without the columns named `missing`."""
        logged, value = self.sonar.read(ping, rng)
        for operator in self.operators:
            value = operator(value, logged, rng)
        value = self.register(value)
        for operator in self.link:
            value = self.register(operator(value, logged, rng))
        answered = rng.random(len(value)) >= self.unanswered
        status = np.where(value > 0.0, EchoStatus.ECHO, EchoStatus.NO_ECHO)
        reading = Reading.of(np.where(answered, value, 0.0), np.where(answered, status, EchoStatus.NO_ANSWER))
        recording = Recording.of(logged, reading, name="sonar")
        return replace(recording, table=recording.table.drop(columns=[c for c in missing if recording.has(c)]))

    def with_sonar(self, **change: Any) -> World:
        """Return a world whose sonar has other values of some fields."""
        return replace(self, sonar=replace(self.sonar, **change))

    def with_link(self, operator: Operator) -> World:
        """Return a world with one more fault of the link."""
        return replace(self, link=(*self.link, operator))


@dataclass(frozen=True)
class Planted:
    """The simulated and the real world after a cause was planted.

    Attributes:
        simulated: world without the effect.
        recorded: world with it.
        value: true value of the cause's parameter.
        region: where it acts, SI units.
    """

    simulated: World
    recorded: World
    value: float | None = None
    region: Region = field(default_factory=dict)


@dataclass(frozen=True)
class Cause:
    """A known cause of a family.

    Attributes:
        effect: id in the catalogue.
        plant: given a world, a size (1 is plain to see) and a generator, the world without and with the effect.
        aspects: in which it shows.
        accepted: further ids that are correct.
        parameter: whose true value is known.
        hides: columns that would give the cause away, which are neither logged nor varied.
        needs: columns without which the cause cannot be recognised.
        survey: settings of the survey that the cause requires.
    """

    effect: str
    plant: Callable[[World, float, Rng], Planted]
    aspects: tuple[str, ...]
    accepted: tuple[str, ...] = ()
    parameter: str | None = None
    hides: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    survey: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Surveys:
    """Pings of the simulated, the recorded and the fresh recordings, and columns that are not logged."""

    simulated: Ping
    recorded: Ping
    fresh: Ping
    missing: tuple[str, ...] = ()


def _same(world: World, rng: Rng) -> World:
    return world


@dataclass(frozen=True)
class Family:
    """A family of generators.

    Attributes:
        world: draws a sonar in its surroundings.
        surveys: draws surveys, given the number of pings and settings that a cause requires.
        causes: that can be planted.
        another_day: the same sonar on another day.
        simulator: a simulation of another kind of the real world, and that real world; None where there is none.
    """

    world: Callable[[Rng], World]
    surveys: Callable[[Rng, int, Mapping[str, Any]], Surveys]
    causes: tuple[Cause, ...]
    another_day: Callable[[World, Rng], World] = _same
    simulator: Callable[[World, Rng], tuple[World, World]] | None = None


def visits(ping: Ping) -> Ints:
    """Return the visit of each ping, (n,): a visit ends where the condition or the run changes."""
    condition = np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.run])
    return np.cumsum(np.concatenate([[0], np.any(np.diff(condition, axis=1) != 0.0, axis=0)]))


def starts_run(ping: Ping) -> Bits:
    """Return whether each ping is the first of its run, (n,)."""
    return np.diff(ping.run, prepend=ping.run[:1] - 1) != 0


def scattered(ping: Ping, sd_m: float, rng: Rng) -> Floats:
    """Return distances with a placement error of standard deviation `sd_m` in each visit, m, (n,)."""
    visit = visits(ping)
    return np.maximum(ping.distance + rng.normal(0.0, sd_m, visit[-1] + 1)[visit], 0.02)


def shifted(value: Floats, change: Floats | float) -> Floats:
    """Return readings with a change of the echoes, m; an echo stays an echo."""
    return np.where(value > 0.0, np.maximum(value + change, 1e-3), 0.0)


def sign(rng: Rng) -> float:
    """Return -1 or 1."""
    return float(rng.choice([-1.0, 1.0]))


def dropped(share: float) -> Operator:
    """Return a link that loses a share of the readings."""
    return lambda value, ping, rng: np.where(rng.random(len(value)) < share, 0.0, value)


def stale(share: float) -> Operator:
    """Return a link on which a share of the commands is lost: the register still holds the previous reading."""

    def repeat(value: Floats, ping: Ping, rng: Rng) -> Floats:
        lost = (rng.random(len(value)) < share) & ~starts_run(ping)
        return value[np.maximum.accumulate(np.where(lost, -1, np.arange(len(value))))]

    return repeat


def stuck(share: float, at_m: float) -> Operator:
    """Return a link that gives one constant for a share of the readings."""
    return lambda value, ping, rng: np.where(rng.random(len(value)) < share, at_m, value)


def spikes(share: float) -> Operator:
    """Return a link that replaces a share of the readings by uniform ones."""
    return lambda value, ping, rng: np.where(
        rng.random(len(value)) < share, rng.uniform(0.0, FULL_SCALE_M, len(value)), value
    )


def noisy(share: float, sigma_m: float) -> Operator:
    """Return a link that adds a normal error to a share of the echoes."""
    return lambda value, ping, rng: np.where(
        rng.random(len(value)) < share, shifted(value, rng.normal(0.0, sigma_m, len(value))), value
    )


def flipped(share: float, step_m: float) -> Operator:
    """Return a link that inverts one of 16 bits of a share of the echoes; a count of zero is no echo."""

    def flip(value: Floats, ping: Ping, rng: Rng) -> Floats:
        count = np.clip(np.rint(value / step_m), 0, 65_535).astype(np.int64)
        wrong = np.bitwise_xor(count, 1 << rng.integers(0, 16, len(value))) * step_m
        return np.where((rng.random(len(value)) < share) & (value > 0.0), wrong, value)

    return flip


def by_share(largest: float, at_one: float, operator: Callable[[float], Operator]) -> Callable[..., Planted]:
    """Return how a fault of the link is planted: `at_one` is the share of readings at size 1, `largest` its limit."""

    def plant(world: World, size: float, rng: Rng) -> Planted:
        share = min(largest, at_one * size)
        return Planted(world, world.with_link(operator(share)), share)

    return plant


def _plant_stuck(world: World, size: float, rng: Rng) -> Planted:
    share, at = min(0.5, 0.05 * size), float(world.register(np.array([rng.uniform(0.3, 3.0)]))[0])
    return Planted(world, world.with_link(stuck(share, at)), share)


def _plant_noise(world: World, size: float, rng: Rng) -> Planted:
    share = min(0.6, 0.10 * size)
    return Planted(world, world.with_link(noisy(share, float(rng.uniform(0.04, 0.15)))), share)


def _plant_flips(world: World, size: float, rng: Rng) -> Planted:
    share = min(0.4, 0.05 * size)
    return Planted(world, world.with_link(flipped(share, world.register.step_m)), share)


def _plant_step(truncated: bool) -> Callable[[World, float, Rng], Planted]:
    """Return how a coarse register is planted: 1 inch at size 1, in place of a fine one."""

    def plant(world: World, size: float, rng: Rng) -> Planted:
        fine, step = Register(0.001, truncated), max(0.003, round(0.0254 * size, 4))
        return Planted(replace(world, register=fine), replace(world, register=Register(step, truncated)), step)

    return plant


LINK_CAUSES = (
    Cause("dropped_reading", by_share(0.5, 0.06, dropped), ("detection",), parameter="probability"),
    Cause("stale_repeat", by_share(0.5, 0.12, stale), ("repeat", "memory", "early", "late"), parameter="probability"),
    Cause("stuck", _plant_stuck, ("early", "late", "coincidence"), parameter="probability"),
    Cause("spike", by_share(0.4, 0.05, spikes), ("late", "early", "spread"), parameter="probability"),
    Cause("noise_burst", _plant_noise, ("spread", "early", "late"), parameter="probability"),
    Cause("corrupted_byte", _plant_flips, ("late", "early", "spread"), ("spike",), "probability"),
    Cause("quantisation", _plant_step(False), ("spread", "bias", "repeat", "skew"), ("truncation",), "step_m"),
    Cause("truncation", _plant_step(True), ("bias", "spread", "repeat", "skew"), ("quantisation",), "step_m"),
)
