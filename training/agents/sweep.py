"""Train agents with several seeds and settings on Ray Tune, on one machine or a cluster. Needs the extra `ray`.

Each trial is a `sonar-gym train-agent` in a folder of its own. To continue an interrupted sweep, give the same command
again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import ray
from annotated_types import MinLen
from ray import tune

from acquisition import SettingError
from acquisition.io.files import write_text
from acquisition.io.places import OutputFolder
from acquisition.limits import Limit, Rate, Seed, Workers
from noise.fitting.threads import one_thread
from noise.store import ModelName
from training.agents import train

NAME = "tune"  # folder of Ray Tune's own state
VARIED = ("seed", "learning_rate", "sonar")


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym sweep`."""

    out: OutputFolder = Path("runs/sweep")
    """Folder for trials and results; on a cluster, one that all machines share."""
    seeds: Annotated[tuple[Seed, ...], MinLen(1)] = (0, 1, 2)
    """Seeds of training."""
    learning_rates: Annotated[tuple[Rate, ...], MinLen(1)] = (1e-4,)
    """Learning rates of PPO."""
    sonars: Annotated[tuple[ModelName, ...], MinLen(1)] = ("ideal", "srf08-mlp")
    """Names or folders of sonar models; each agent trains with one."""
    lessons: Annotated[int, Limit(0, 1_000_000)] = 1000
    """Rounds of imitation of each agent."""
    steps: Annotated[int, Limit(0, 10**12)] = 1_000_000
    """Environment steps of PPO of each agent."""
    num_envs: Annotated[int, Limit(1, 65_536)] = 128
    """Number of cars of each agent."""
    workers: Workers = 2
    """Number of trials that run at the same time, one processor each."""
    address: str | None = None
    """Address of a Ray cluster, e.g. auto; by default Ray starts on this machine."""

    @property
    def space(self) -> dict[str, Any]:
        """Ray Tune's parameter space: the full grid."""
        values = dict(zip(VARIED, (self.seeds, self.learning_rates, self.sonars), strict=True))
        return {name: tune.grid_search(list(value)) for name, value in values.items()}


def trial(args: Args) -> Callable[[dict[str, Any]], None]:
    """Return the function that Ray Tune runs: the training of one trial, reported after every leg."""

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
    """Run or continue a sweep; returns the last results of each trial."""
    if not ray.is_initialized():
        local = {"num_cpus": args.workers, "include_dashboard": False} if args.address is None else {}
        try:
            ray.init(address=args.address, **local)
        except (ConnectionError, ValueError) as error:
            raise SettingError(f"--address {args.address}: no Ray cluster answers there ({error})") from None
    results = _tuner(replace(args, out=args.out.absolute())).fit()
    if results.errors:
        raise SettingError(f"{len(results.errors)} trials of the sweep failed; the first error: {results.errors[0]}")
    return table(results.get_dataframe())


def _tuner(args: Args) -> tune.Tuner:
    """Return the tuner of a sweep, restored where there is one."""
    path = str(args.out / NAME)
    if tune.Tuner.can_restore(path):
        return tune.Tuner.restore(path, trial(args), resume_errored=True, restart_errored=False)
    return tune.Tuner(
        trial(args),
        param_space=args.space,
        tune_config=tune.TuneConfig(max_concurrent_trials=args.workers),
        run_config=tune.RunConfig(name=NAME, storage_path=str(args.out), verbose=0),
    )


def table(results: pd.DataFrame) -> pd.DataFrame:
    """Return parameters and results, one trial per row."""
    names = {f"config/{name}": name for name in VARIED}
    columns = [*names, "steps", "success", "collision", "score", "seconds_an_episode"]
    return results[columns].rename(columns=names).sort_values(list(VARIED)).reset_index(drop=True)


def main(args: Args) -> None:
    """Run the sweep, print its table, and write sweep.csv."""
    results = run(args)
    write_text(args.out / "sweep.csv", results.to_csv(index=False))
    print(results.to_string(index=False))
