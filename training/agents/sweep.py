"""Train agents of several seeds and settings on Ray Tune, on one machine or many; killed, it goes on where it was.

Needs the extra `ray`. Every trial is a training of `sonar-gym train-agent` with a folder and checkpoints of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import ray
from ray import tune

from acquisition import SettingError
from acquisition.io.files import write_text
from noise.fitting.threads import one_thread
from training.agents import train

NAME = "tune"  # folder of Ray Tune's own notes
VARIED = ("seed", "learning_rate", "sonar")


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym sweep`."""

    out: Path = Path("runs/sweep")
    """Folder of trials and results; on many machines one that all of them see."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds to train with."""
    learning_rates: tuple[float, ...] = (1e-4,)
    """Of PPO."""
    sonars: tuple[str, ...] = ("ideal", "srf08-mlp")
    """Names or folders of models to train with, each apart."""
    lessons: int = 1000
    """Rounds of imitation of each agent."""
    steps: int = 1_000_000
    """Steps of trial of each agent."""
    num_envs: int = 128
    """Cars of each agent."""
    workers: int = 2
    """Trials at the same time, a processor each."""
    address: str | None = None
    """Of a Ray cluster, for example auto; without, Ray is started on this machine."""

    def __post_init__(self) -> None:
        """Refuse a sweep of nothing."""
        if self.workers < 1 or not (self.seeds and self.learning_rates and self.sonars):
            raise SettingError(f"give a worker or more ({self.workers}), and seeds, learning rates and sonars")

    @property
    def space(self) -> dict[str, Any]:
        """What is varied, every value of each with every one of the others."""
        values = dict(zip(VARIED, (self.seeds, self.learning_rates, self.sonars), strict=True))
        return {name: tune.grid_search(list(value)) for name, value in values.items()}


def trial(args: Args) -> Callable[[dict[str, Any]], None]:
    """Return what Ray Tune runs: a training with the values of one trial, told leg by leg."""

    def run(config: dict[str, Any]) -> None:
        folder = "-".join(f"{name}={Path(str(config[name])).name}" for name in VARIED)
        settings = train.Args(
            args.out / "agents" / folder,
            sonars=(config["sonar"],),
            lessons=args.lessons,
            steps=args.steps,
            num_envs=args.num_envs,
            learning_rate=config["learning_rate"],
            seed=config["seed"],
        )
        with one_thread():
            training = train.Training(settings)
            training.resume()
            for one in training.history:
                tune.report(dict(one))
            training.run(lambda: tune.report(dict(training.history[-1])))
        training.envs.close()

    return run


def run(args: Args) -> pd.DataFrame:
    """Run or go on with a sweep; returns a trial a row, with its last numbers."""
    if not ray.is_initialized():
        own = {"num_cpus": args.workers, "include_dashboard": False} if args.address is None else {}
        ray.init(address=args.address, **own)
    home = args.out.absolute()
    held = Args(**{**vars(args), "out": home})
    known = tune.Tuner.can_restore(str(home / NAME))
    tuner = (
        tune.Tuner.restore(str(home / NAME), trial(held), resume_errored=True, restart_errored=False)
        if known
        else tune.Tuner(
            trial(held),
            param_space=args.space,
            tune_config=tune.TuneConfig(max_concurrent_trials=args.workers),
            run_config=tune.RunConfig(name=NAME, storage_path=str(home), verbose=0),
        )
    )
    found = tuner.fit()
    if found.errors:
        raise SettingError(f"{len(found.errors)} trials of the sweep failed, the first by {found.errors[0]}")
    return table(found.get_dataframe())


def table(found: pd.DataFrame) -> pd.DataFrame:
    """Return what was varied and what came of it, a trial a row."""
    names = {f"config/{name}": name for name in VARIED}
    columns = [*names, "steps", "success", "collision", "score", "seconds_an_episode"]
    return found[columns].rename(columns=names).sort_values(list(VARIED)).reset_index(drop=True)


def main(args: Args) -> None:
    """Run the sweep, print its table, write sweep.csv."""
    found = run(args)
    write_text(args.out / "sweep.csv", found.to_csv(index=False))
    print(found.to_string(index=False))
