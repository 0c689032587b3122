"""Drive the same streets with each agent and sonar, and print success and collision rates with 95 % intervals."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Protocol

import gymnasium
import numpy as np
from annotated_types import MinLen
from rich.console import Console
from rich.table import Table

import sonar_gym
from acquisition import SettingError
from acquisition.arrays import Bits, Floats, Ints, Singles
from acquisition.io.files import write_text
from acquisition.io.places import OutputFile
from acquisition.limits import Count, Loadable, Seed
from noise.credence import wilson
from noise.store import ModelName
from sonar_gym.agent import AgentDriver, Policy, VectorAgent, load_policy
from sonar_gym.control.driver import Controller, Episode, ParkingDriver, run_episode
from sonar_gym.parking.fleet import MAX_STEPS, Fleet, Observation
from sonar_gym.parking.step_kernel import COLLISION, PARKED
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sensing.odometry import OdometryName
from sonar_gym.street.street import Difficulty
from training.agents.sonars import mismatched
from training.common.progress import OnProgress, progress_bars
from training.common.statistics import PairedComparison

STREETS_AT_ONCE = 250
SCRIPTED = "scripted"  # name of the scripted driver
FRAME_STEPS = 3  # steps from frame to frame of a film
OF_COMMANDS = ("agent", "model.zip")  # names of what every `train-agent` and `zoo` writes into its own folder

# ---- evaluation ------------------------------------------------------------------------------------------------------


class DriverPool(Protocol):
    """Drives many cars from their observations."""

    def reset(self, rows: Ints) -> None:
        """Begin new episodes with some cars."""

    def act(self, observation: Observation, rows: Ints) -> Singles:
        """Return an action for each of some cars, (r, 2)."""
        ...


class ScriptedPool:
    """One scripted driver per car.

    Args:
        count: number of cars.
        settings: arguments of `ParkingDriver`.
    """

    def __init__(self, count: int, **settings: Any) -> None:
        self._drivers = [ParkingDriver(**settings) for _ in range(count)]

    def reset(self, rows: Ints) -> None:
        """Begin new episodes with some cars."""
        for row in rows:
            self._drivers[row].reset()

    def act(self, observation: Observation, rows: Ints) -> Singles:
        """Return an action for each of some cars, (r, 2)."""
        each = [{name: value[k] for name, value in observation.items()} for k in range(len(rows))]
        return np.stack([self._drivers[row].act(one) for row, one in zip(rows, each, strict=True)])


def pool_of(policy: Policy | str) -> Callable[[int], DriverPool]:
    """Return a function that makes a pool of n drivers, from a policy or the name of the scripted driver."""
    if isinstance(policy, Policy):
        return lambda count: VectorAgent(policy, count)
    if policy != SCRIPTED:
        raise SettingError(f"driver {policy!r}: expected a policy or {SCRIPTED!r}")
    return ScriptedPool


def driver_name(driver: str) -> str:
    """Return a short name of a driver, that of the folder for what a command has written into it.

    >>> [driver_name(one) for one in ("scripted", "runs/first/agent", "runs/ppo/model.zip", "mine.zip", "cars:Pool")]
    ['scripted', 'first', 'ppo', 'mine', 'cars:Pool']
    """
    path = Path(os.path.abspath(driver))
    if path.name in OF_COMMANDS:
        return path.parent.name
    return path.stem if path.suffix == ".zip" else path.name


@dataclass(frozen=True)
class Rate:
    """Number of events in a number of trials."""

    count: int
    trials: int

    @property
    def share(self) -> float:
        """Relative frequency, 0..1."""
        return self.count / self.trials

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson interval at 95 %."""
        low, high = wilson(self.count, self.trials)
        return float(low), float(high)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{100 * self.share:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Results of episodes, in the order of their seeds.

    Attributes:
        seeds: seeds of the streets, (n,).
        success, collision: whether the car parked, and whether it collided, (n,).
        steps: number of steps, (n,).
        score: sum of rewards, (n,).
    """

    seeds: Ints
    success: Bits
    collision: Bits
    steps: Ints
    score: Floats

    @property
    def successes(self) -> Rate:
        """Rate of parking."""
        return Rate(int(self.success.sum()), len(self.success))

    @property
    def collisions(self) -> Rate:
        """Rate of collisions."""
        return Rate(int(self.collision.sum()), len(self.collision))

    @property
    def mean_seconds(self) -> float:
        """Mean length of an episode, s."""
        return 0.1 * float(self.steps.mean())

    @classmethod
    def joined(cls, parts: Sequence[Outcomes]) -> Outcomes:
        """Concatenate several results."""
        names = ("seeds", "success", "collision", "steps", "score")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def evaluate(
    make_pool: Callable[[int], DriverPool],
    settings: dict[str, Any],
    seeds: Sequence[int],
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    pooled: bool = False,
    watch: Callable[[Fleet, Ints], None] = lambda fleet, rows: None,
) -> Outcomes:
    """Drive one episode on the street of each seed.

    Args:
        make_pool: makes the drivers of n cars.
        settings: settings of `SonarParkingVectorEnv`.
        seeds: seeds of streets, sonars and odometers.
        on_progress: called with the number of finished episodes and their total.
        pooled: whether to draw the sonars of all cars at once, which is faster with a rig. The readings of a car then
            differ from those of the same car driven alone, but follow the same law.
        watch: called after each step with the cars and the numbers of those that were stepped.
    """
    parts = []
    for begin in range(0, len(seeds), STREETS_AT_ONCE):
        some = list(seeds[begin : begin + STREETS_AT_ONCE])
        on_end = partial(_on_end, on_progress, begin, len(seeds))
        parts.append(_drive(make_pool(len(some)), settings, some, pooled, on_end, watch))
    return Outcomes.joined(parts)


def _on_end(on_progress: Callable[[int, int], None], before: int, total: int, ended: int) -> None:
    on_progress(before + ended, total)


def _drive(
    pool: DriverPool,
    settings: dict[str, Any],
    seeds: list[int],
    pooled: bool,
    on_end: Callable[[int], None],
    watch: Callable[[Fleet, Ints], None],
) -> Outcomes:
    """Drive some streets at once; finished cars are not stepped, since a rig is slow."""
    n = len(seeds)
    envs = SonarParkingVectorEnv(n, **settings)
    envs.fleet.sonar.law.batched |= pooled
    envs.reset(seed=seeds)
    pool.reset(np.arange(n))
    fleet, score, rows = envs.fleet, np.zeros(n), np.arange(n)
    while len(rows):
        actions = pool.act(fleet.observation(rows), rows)
        fleet.step(rows, np.clip(actions.astype(np.float64), -1.0, 1.0))
        score[rows] += fleet.worlds.terms[rows].sum(axis=1)
        watch(fleet, rows)
        rows = rows[~fleet.worlds.ended[rows].any(axis=1) & (fleet.worlds.steps[rows] < MAX_STEPS)]
        on_end(n - len(rows))
    envs.close()
    ended, steps = fleet.worlds.ended, fleet.worlds.steps
    return Outcomes(np.asarray(seeds), ended[:, PARKED].copy(), ended[:, COLLISION].copy(), steps.copy(), score)


# ---- the command -----------------------------------------------------------------------------------------------------


def _check_agent(name: str) -> object:
    return None if name == SCRIPTED else load_policy(name)


AgentName = Annotated[str, Loadable(_check_agent)]


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym evaluate-agent`."""

    agent: Annotated[tuple[AgentName, ...], MinLen(1)] = ("parking", SCRIPTED)
    """Names or folders of agents; "scripted" is the scripted driver. The first is the reference of the comparison."""
    sonars: Annotated[tuple[ModelName, ...], MinLen(1)] = ("ideal", "srf08-mlp")
    """Names or folders of sonar models."""
    believed: ModelName | None = None
    """Name or folder of the model for credence, e.g. srf08-mlp for "rig"; by default the model of each sonar."""
    odometry: OdometryName = "exact"
    """Error of the odometry: exact, wheels, worn."""
    difficulty: Difficulty = "normal"
    """Difficulty of the streets: easy, normal, hard, manoeuvre."""
    episodes: Count = 500
    """Number of streets; the same streets for every agent and sonar."""
    seed: Seed = 0
    """Seed of the first street; the others follow. No agent was trained on seeds below 2147483648."""
    out: OutputFile | None = None
    """JSON file for the results."""
    film: OutputFile | None = None
    """GIF file for a film of the first agent on the first street with each sonar."""
    render: bool = False
    """Show the first agent on the first street in a window, with each sonar."""

    def __post_init__(self) -> None:
        """Raise SettingError for invalid values."""
        if self.film is not None and self.film.suffix != ".gif":
            raise SettingError(f"--film {self.film}: must end with .gif")

    def env_settings(self, sonar: str) -> dict[str, Any]:
        """Return the settings of the environment with a sonar."""
        return {"sonar": mismatched(sonar, self.believed), "odometry": self.odometry, "difficulty": self.difficulty}


Results = dict[tuple[str, str], Outcomes]  # by agent and sonar


def driver_of(name: str) -> Controller:
    """Return the driver of one car, by an agent's name or folder."""
    return ParkingDriver() if name == SCRIPTED else AgentDriver(load_policy(name))


def compare(args: Args, on_progress: OnProgress = lambda name, done, total: None) -> Results:
    """Drive all streets with every agent and sonar."""
    results: Results = {}
    pools = {name: pool_of(name if name == SCRIPTED else load_policy(name)) for name in args.agent}
    seeds, pooled = range(args.seed, args.seed + args.episodes), args.believed is not None
    for sonar in args.sonars:
        for name, pool in pools.items():
            update = partial(on_progress, f"{driver_name(name)}, {Path(sonar).name}")
            results[name, sonar] = evaluate(pool, args.env_settings(sonar), seeds, update, pooled)
    return results


def table(args: Args, results: Results) -> Table:
    """Return the results as a table for the terminal."""
    last, reference = args.seed + args.episodes - 1, args.agent[0]
    assumed = "" if args.believed is None else f"credence from {Path(args.believed).name}; "
    title = f"streets {args.seed} to {last}, {args.difficulty}, odometry {args.odometry}; {assumed}intervals at 95 %"
    out = Table("sonar", "agent", title=title)
    for heading in ("parked", "collided", "seconds", f"difference to {driver_name(reference)}, points"):
        out.add_column(heading, justify="right")
    for (name, sonar), one in results.items():
        first = results[reference, sonar]
        change = "" if one is first else str(PairedComparison.of(first.success, one.success))
        rates = (str(one.successes), str(one.collisions))
        out.add_row(Path(sonar).name, driver_name(name), *rates, f"{one.mean_seconds:.1f}", change)
    return out


def records(args: Args, results: Results) -> list[dict[str, Any]]:
    """Return the results as plain data, one record per agent and sonar."""
    return [
        {
            "agent": name,
            "sonar": sonar,
            "episodes": len(one.seeds),
            "first_seed": args.seed,
            "believed": args.believed,
            "odometry": args.odometry,
            "difficulty": args.difficulty,
            "success": one.successes.share,
            "success_interval": one.successes.interval,
            "collision": one.collisions.share,
            "collision_interval": one.collisions.interval,
            "mean_seconds": one.mean_seconds,
            "failed_seeds": one.seeds[~one.success].tolist(),
        }
        for (name, sonar), one in results.items()
    ]


def drive(args: Args, sonar: str, mode: str) -> Episode:
    """Drive the first street with the first agent, and render it."""
    env = gymnasium.make(sonar_gym.ENV_ID, render_mode=mode, **args.env_settings(sonar))
    try:
        return run_episode(env, driver_of(args.agent[0]), args.seed, every=FRAME_STEPS)
    finally:
        env.close()


def main(args: Args) -> None:
    """Evaluate, print the table, and write the requested files."""
    with progress_bars() as on_progress:
        results = compare(args, on_progress)
    Console(soft_wrap=True).print(table(args, results))
    if args.out is not None:
        write_text(args.out, json.dumps(records(args, results), indent=2) + "\n")
    if args.film is not None:
        from training.diagnosis.demo_page import gif  # loads the whole diagnosis
        from training.diagnosis.drive import Drive

        gif({Path(sonar).name: Drive.of(drive(args, sonar, "rgb_array")) for sonar in args.sonars}, args.film)
    if args.render:
        for sonar in args.sonars:
            drive(args, sonar, "human")
