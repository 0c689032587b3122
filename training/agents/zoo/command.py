"""Train a plain algorithm of Stable-Baselines3 with tuned settings, and test it on unseen streets."""

from __future__ import annotations

import io
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from string import Template
from typing import Annotated, Any

import gymnasium
import tyro
from rich.console import Console
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnv

import sonar_gym
from acquisition.io.files import write_bytes, write_text
from acquisition.io.places import OutputFolder
from acquisition.limits import Count, Limit
from noise.fitting.threads import one_thread
from noise.store import ModelName
from sonar_gym.sb3 import SonarVecEnv
from training.agents.evaluate import Rate
from training.agents.zoo.settings import Tuned, tuned
from training.common.progress import OnProgress, progress_bars

CARD = Path(__file__).parents[1] / "templates" / "zoo_card.md"
MODEL, README, RESULT, BOARD = "model.zip", "README.md", "result.json", "tensorboard"
STREETS_AT_ONCE = 100
TRAINING_SEEDS = 2**31  # streets of training have this seed or a higher one; lower seeds are for evaluation


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym zoo`."""

    algorithm: Annotated[str, tyro.conf.Positional]
    """Name of the algorithm: ppo, or sac with hindsight experience replay on the goal environment."""
    out: OutputFolder
    """Folder for model.zip, README.md, result.json and tensorboard/."""
    env: str = sonar_gym.ENV_ID
    """Id of the environment."""
    sonar: ModelName = "ideal"
    """Name or folder of a sonar model."""
    steps: Annotated[int, Limit(1, 10**12)] | None = None
    """Steps of all environments together; by default the tuned number."""
    episodes: Count = 200
    """Number of unseen streets of the test."""
    seed: Annotated[int, Limit(0, TRAINING_SEEDS - 1)] = 0
    """The same seed gives the same model on the same machine."""


def make_envs(env_id: str, count: int, sonar: str) -> VecEnv:
    """Return n environments of an id: the native vector environment, or single ones where it has none."""
    spec = gymnasium.spec(env_id)
    if spec.vector_entry_point is not None:
        return VecMonitor(SonarVecEnv(count, sonar=sonar, **spec.kwargs))
    return make_vec_env(env_id, count, env_kwargs={"sonar": sonar})


class _Report(BaseCallback):
    """Reports the number of steps."""

    def __init__(self, on_progress: OnProgress, total: int) -> None:
        super().__init__()
        self._report, self._total = on_progress, total

    def _on_step(self) -> bool:
        self._report("training", min(self.num_timesteps, self._total), self._total)
        return True


def train(args: Args, settings: Tuned, on_progress: OnProgress = lambda name, done, total: None) -> BaseAlgorithm:
    """Return a trained model; success rate, rewards and losses go to TensorBoard."""
    envs = make_envs(args.env, settings.n_envs, args.sonar)
    policy, keywords = settings.keywords["policy"], {k: v for k, v in settings.keywords.items() if k != "policy"}
    model = settings.algorithm_class(
        policy, envs, seed=args.seed, device="cpu", tensorboard_log=str(args.out / BOARD), **keywords
    )
    envs.seed(TRAINING_SEEDS + settings.n_envs * args.seed)
    steps = settings.n_timesteps if args.steps is None else args.steps
    callbacks = [_Report(on_progress, steps), *settings.make_callbacks()]
    model.learn(steps, callback=callbacks, tb_log_name=f"{settings.algorithm}_{args.seed}")
    envs.close()
    return model


def parked(model: BaseAlgorithm, args: Args) -> Rate:
    """Return how many streets with seeds from 0 a model parks in, without exploration."""
    ends: list[bool] = []

    def note_end(now: dict[str, Any], _: dict[str, Any]) -> None:
        if now["done"]:
            ends.append(bool(now["info"]["is_success"]))

    for begin in range(0, args.episodes, STREETS_AT_ONCE):
        count = min(STREETS_AT_ONCE, args.episodes - begin)
        envs = make_envs(args.env, count, args.sonar)
        envs.seed(begin)
        evaluate_policy(model, envs, count, callback=note_end)
        envs.close()
    return Rate(sum(ends), len(ends))


def write(args: Args, settings: Tuned, model: BaseAlgorithm, rate: Rate, seconds: float) -> None:
    """Write model, card and result into the folder."""
    data = io.BytesIO()
    model.save(data)
    write_bytes(args.out / MODEL, data.getvalue())
    result = {
        **{name: value for name, value in asdict(args).items() if name != "out"},
        "steps": model.num_timesteps,
        "seconds": round(seconds, 1),
        "parked": rate.count,
        "share": rate.share,
        "interval": rate.interval,
    }
    write_text(args.out / RESULT, json.dumps(result, indent=2) + "\n")
    names = {name: getattr(value, "__name__", value) for name, value in settings.keywords.items()}
    names |= settings.callbacks
    fields = {**result, "class_name": type(model).__name__, "rate": rate, "environments": settings.n_envs}
    fields["settings"] = "\n".join(f"- `{name}`: {value}" for name, value in names.items())
    write_text(args.out / README, Template(CARD.read_text(encoding="utf-8")).substitute(fields))


def main(args: Args) -> None:
    """Train, test, write, and print the result."""
    settings, begin = tuned(args.algorithm, args.env), time.perf_counter()
    with one_thread(), progress_bars() as on_progress:
        model = train(args, settings, on_progress)
        seconds = time.perf_counter() - begin
        rate = parked(model, args)
    write(args, settings, model, rate, seconds)
    Console(highlight=False, soft_wrap=True).print(
        f"{args.out / MODEL}: parked in {rate} of {rate.trials} unseen streets of {args.env}, "
        f"{model.num_timesteps} steps in {seconds:.0f} s"
    )
