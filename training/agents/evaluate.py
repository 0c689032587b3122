"""Drive the streets of given seeds, many at once, and say how often it went well, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from acquisition import SettingError
from sonar_gym.agent import Agents, Policy
from sonar_gym.control.driver import ParkingDriver
from sonar_gym.parking.fleet import MAX_STEPS
from sonar_gym.parking.step_kernel import COLLISION, PARKED
from sonar_gym.parking.vector import SonarParkingVectorEnv
from training.common.paired import CONFIDENCE

Bits = NDArray[np.bool_]
Ints = NDArray[np.int64]
Singles = NDArray[np.float32]
Observation = dict[str, Singles]
TOGETHER = 250  # streets driven at the same time
SCRIPTED = "scripted"  # name of the driver written by hand


class Crew(Protocol):
    """Anything that drives many cars from what each observes."""

    def forget(self, rows: Ints) -> None:
        """Begin episodes with some cars."""

    def act(self, observation: Observation, rows: Ints) -> Singles:
        """Return an action for each of some cars, (r, 2)."""
        ...


class Scripted:
    """The driver written by hand, once a car."""

    def __init__(self, count: int) -> None:
        self._drivers = [ParkingDriver() for _ in range(count)]

    def forget(self, rows: Ints) -> None:
        """Begin episodes with some cars."""
        for row in rows:
            self._drivers[row].reset()

    def act(self, observation: Observation, rows: Ints) -> Singles:
        """Return an action for each of some cars, (r, 2)."""
        each = [{name: value[k] for name, value in observation.items()} for k in range(len(rows))]
        return np.stack([self._drivers[row].act(one) for row, one in zip(rows, each, strict=True)])


def crew_of(policy: Policy | str) -> Callable[[int], Crew]:
    """Return what makes a crew of n: of a policy, or of the driver written by hand."""
    if isinstance(policy, Policy):
        return lambda count: Agents(policy, count)
    if policy != SCRIPTED:
        raise SettingError(f"driver {policy!r}: expected a policy or {SCRIPTED!r}")
    return Scripted


@dataclass(frozen=True)
class Rate:
    """How often something happened.

    Attributes:
        count: how often.
        of: how many times it could have.
    """

    count: int
    of: int

    @property
    def share(self) -> float:
        """0..1."""
        return self.count / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's score interval at 95 % (Wilson 1927)."""
        found = binomtest(self.count, self.of).proportion_ci(CONFIDENCE, method="wilson")
        return float(found.low), float(found.high)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{100 * self.share:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


@dataclass(frozen=True, eq=False)
class Outcomes:
    """How episodes ended, in the order of their seeds.

    Attributes:
        seeds: of the streets, (n,).
        success, collision: (n,).
        steps: actions taken, (n,).
        score: sums of rewards, (n,).
    """

    seeds: Ints
    success: Bits
    collision: Bits
    steps: Ints
    score: NDArray[np.float64]

    @property
    def successes(self) -> Rate:
        """How often the car parked."""
        return Rate(int(self.success.sum()), len(self.success))

    @property
    def collisions(self) -> Rate:
        """How often it touched something."""
        return Rate(int(self.collision.sum()), len(self.collision))

    @classmethod
    def joined(cls, parts: Sequence[Outcomes]) -> Outcomes:
        """Return several as one."""
        names = ("seeds", "success", "collision", "steps", "score")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def evaluate(
    crew: Callable[[int], Crew],
    world: dict[str, Any],
    seeds: Sequence[int],
    tell: Callable[[int, int], None] = lambda done, of: None,
    pooled: bool = False,
) -> Outcomes:
    """Drive one episode on the street of each seed.

    Args:
        crew: makes drivers of n cars.
        world: settings of `SonarParkingVectorEnv`.
        seeds: of the streets, and of sonars and odometers.
        tell: called with how many episodes are over, and how many there are.
        pooled: whether the sonars of all cars are drawn at once, which a rig does faster; what one car hears is then
            another draw of the same law when it drives alone.
    """
    parts = []
    for begin in range(0, len(seeds), TOGETHER):
        some = list(seeds[begin : begin + TOGETHER])
        parts.append(_drive(crew(len(some)), world, some, pooled, lambda over, b=begin: tell(b + over, len(seeds))))  # type: ignore[misc]
    return Outcomes.joined(parts)


def _drive(crew: Crew, world: dict[str, Any], seeds: list[int], pooled: bool, tell: Callable[[int], None]) -> Outcomes:
    """Drive some streets at once; cars whose episodes are over are stepped no more, since a rig takes its time."""
    n = len(seeds)
    envs = SonarParkingVectorEnv(n, **world)
    envs.fleet.sonar.at_once |= pooled
    envs.reset(seed=seeds)
    crew.forget(np.arange(n))
    fleet, score, rows = envs.fleet, np.zeros(n), np.arange(n)
    while len(rows):
        wanted = crew.act(fleet.observation(rows), rows)
        fleet.step(rows, np.clip(wanted.astype(np.float64), -1.0, 1.0))
        score[rows] += fleet.worlds.terms[rows].sum(axis=1)
        rows = rows[~fleet.worlds.ended[rows].any(axis=1) & (fleet.worlds.steps[rows] < MAX_STEPS)]
        tell(n - len(rows))
    envs.close()
    ended, steps = fleet.worlds.ended, fleet.worlds.steps
    return Outcomes(np.asarray(seeds), ended[:, PARKED].copy(), ended[:, COLLISION].copy(), steps.copy(), score)
