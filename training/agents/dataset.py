"""Write episodes of drivers as datasets of Minari, one for each driver and sonar. Needs the extra `offline`.

`minari.load_dataset` finds them after MINARI_DATASETS_PATH has been set to the folder.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, NamedTuple

import gymnasium
import minari
import numpy as np
from annotated_types import MinLen
from minari.data_collector.episode_buffer import EpisodeBuffer

import sonar_gym
from acquisition import SettingError
from acquisition.arrays import Bits, Floats, Ints, Singles
from acquisition.io.places import OutputFolder
from acquisition.limits import Count, OneOf, Seed
from noise.fitting.threads import one_thread
from noise.store import ModelName
from sonar_gym.parking.fleet import MAX_STEPS, Fleet, Observation
from sonar_gym.sensing.odometry import OdometryName
from training.agents.drivers import Driver, pool_by_name
from training.agents.evaluate import SCRIPTED, STREETS_AT_ONCE, DriverPool, Rate, driver_name, evaluate
from training.agents.zoo.settings import ALGORITHMS
from training.common.commit import commit
from training.common.progress import progress_bars

NAMESPACE, PLACE = "sonar-parking", "MINARI_DATASETS_PATH"
NO_NAME = re.compile(r"[^\w-]")  # characters that a dataset's name cannot have


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym dataset`."""

    out: OutputFolder
    """Folder for the datasets, sonar-parking/DRIVER-SONAR-v0."""
    drivers: Annotated[tuple[Driver, ...], MinLen(1)] = (SCRIPTED, "parking")
    """Drivers: "scripted", names or folders of agents, files of Stable-Baselines3, or module:callable."""
    sonars: Annotated[tuple[ModelName, ...], MinLen(1)] = ("ideal", "srf08-mlp")
    """Names or folders of sonar models."""
    algorithm: Annotated[str, OneOf(ALGORITHMS)] = "ppo"
    """Algorithm of models of Stable-Baselines3."""
    env: Annotated[str, OneOf(sonar_gym.ENVIRONMENTS)] = sonar_gym.ENV_ID
    """Id of the environment."""
    odometry: OdometryName = "exact"
    """Error of the odometry: exact, wheels, worn."""
    episodes: Count = 500
    """Number of episodes of each dataset; the same streets for all."""
    seed: Seed = 0
    """Seed of the first street; the others follow."""


class Step(NamedTuple):
    """One step of some cars.

    Attributes:
        rows: numbers of the cars, increasing, (r,).
        before, after: observations before and after the step.
        action: what the cars did, (r, 2).
        reward: reward of the step, (r,).
        terminated, truncated: how episodes ended, (r,).
    """

    rows: Ints
    before: Observation
    action: Singles
    reward: Floats
    terminated: Bits
    truncated: Bits
    after: Observation


class Recorder:
    """A pool of drivers that notes what another one observes and does.

    Args:
        pool: the drivers.

    Attributes:
        steps: all steps.
    """

    def __init__(self, pool: DriverPool) -> None:
        self._pool = pool
        self._last: tuple[Observation, Singles] | None = None
        self.steps: list[Step] = []

    def reset(self, rows: Ints) -> None:
        """Begin new episodes with some cars."""
        self._pool.reset(rows)

    def act(self, observation: Observation, rows: Ints) -> Singles:
        """Return an action for each of some cars, (r, 2)."""
        action = np.clip(self._pool.act(observation, rows), -1.0, 1.0).astype(np.float32)
        self._last = observation, action
        return action

    def watch(self, fleet: Fleet, rows: Ints) -> None:
        """Note the result of the last actions."""
        assert self._last is not None  # act comes first
        worlds = fleet.worlds
        terminated: Bits = np.any(worlds.ended[rows], axis=1)
        truncated = ~terminated & (worlds.steps[rows] >= MAX_STEPS)
        reward: Floats = worlds.terms[rows].sum(axis=1)
        after = fleet.observation(rows)
        self.steps.append(Step(rows.copy(), self._last[0], self._last[1], reward, terminated, truncated, after))

    def episodes(self, seeds: Sequence[int]) -> Iterator[EpisodeBuffer]:
        """Yield the episode of each car, with the seed of its street."""
        for row, seed in enumerate(seeds):
            yield _episode([(one, int(np.searchsorted(one.rows, row))) for one in self.steps if row in one.rows], seed)


def _episode(steps: list[tuple[Step, int]], seed: int) -> EpisodeBuffer:
    last, k = steps[-1]
    seen = {name: np.stack([*(one.before[name][i] for one, i in steps), last.after[name][k]]) for name in last.after}
    ends = {
        "rewards": [float(one.reward[i]) for one, i in steps],
        "terminations": [bool(one.terminated[i]) for one, i in steps],
        "truncations": [bool(one.truncated[i]) for one, i in steps],
    }
    return EpisodeBuffer(seed=seed, observations=seen, actions=np.stack([one.action[i] for one, i in steps]), **ends)


def dataset_id(driver: str, sonar: str) -> str:
    """Return the name of a dataset.

    >>> dataset_id("runs/ppo/model.zip", "srf08-mlp")
    'sonar-parking/ppo-srf08-mlp-v0'
    """
    return f"{NAMESPACE}/{NO_NAME.sub('-', f'{driver_name(driver)}-{Path(sonar).name}')}-v0"


def record(args: Args, driver: str, sonar: str, on_progress: Any) -> tuple[list[EpisodeBuffer], Rate]:
    """Return the episodes of a driver with a sonar, and how often it parked."""
    settings = {**gymnasium.spec(args.env).kwargs, "sonar": sonar, "odometry": args.odometry, "threads": 1}
    pool, episodes, parked = pool_by_name(driver, args.algorithm), list[EpisodeBuffer](), 0
    for begin in range(0, args.episodes, STREETS_AT_ONCE):
        seeds = range(args.seed + begin, args.seed + min(begin + STREETS_AT_ONCE, args.episodes))
        recorder = Recorder(pool(len(seeds)))
        outcomes = evaluate(lambda count, one=recorder: one, settings, seeds, watch=recorder.watch)  # type: ignore[misc]
        episodes += recorder.episodes(seeds)
        parked += int(outcomes.success.sum())
        on_progress(f"{driver_name(driver)}, {Path(sonar).name}", len(episodes), args.episodes)
    return episodes, Rate(parked, args.episodes)


def write(args: Args, name: str, episodes: list[EpisodeBuffer], about: dict[str, Any]) -> Path:
    """Write a dataset into the folder, complete or not at all."""
    place = args.out / name
    place.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=args.out) as fresh, warnings.catch_warnings():
        before = os.environ.get(PLACE)
        os.environ[PLACE] = os.path.abspath(fresh)  # Minari joins a relative one to itself
        try:
            warnings.simplefilter("ignore")  # it asks for an author
            minari.create_dataset_from_buffers(name, episodes, data_format="hdf5", **about)
        finally:
            os.environ.pop(PLACE) if before is None else os.environ.update({PLACE: before})
        os.rename(Path(fresh) / name, place)
    return place


def main(args: Args) -> None:
    """Drive, write, and print the rate of parking of each dataset."""
    names = [dataset_id(*pair) for pair in product(args.drivers, args.sonars)]
    for name in names:
        if names.count(name) > 1:
            raise SettingError(f"--drivers, --sonars: {name} would be written twice; rename a folder or file")
        if (args.out / name).exists():
            raise SettingError(f"--out {args.out}: {name} exists; give another folder or remove it")
    version = commit()
    for driver, sonar in product(args.drivers, args.sonars):
        with one_thread(), progress_bars() as on_progress:
            episodes, rate = record(args, driver, sonar, on_progress)
        env = gymnasium.make(args.env, sonar=sonar, odometry=args.odometry)
        description = (
            f"{args.episodes} episodes of {args.env} with the sonar {Path(sonar).name}, odometry {args.odometry}, "
            f"streets from seed {args.seed}; parked in {rate}; commit {version}."
        )
        about = {"env": env, "algorithm_name": driver_name(driver), "description": description}
        place = write(args, dataset_id(driver, sonar), episodes, about)
        env.close()
        print(f"{place}: {description}")
