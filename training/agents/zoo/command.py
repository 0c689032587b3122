"""Train a plain algorithm of Stable-Baselines3 with tuned settings, and test it on unseen streets.

Training is divided into legs with a checkpoint after each. To continue an interrupted training, give the same command
again: each leg draws its streets and random numbers from the seed and its own number, so the result is the same model.
"""

from __future__ import annotations

import io
import json
import math
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from string import Template
from typing import Annotated, Any

import gymnasium
import numpy as np
import tyro
from rich.console import Console
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnv

import sonar_gym
from acquisition.io.files import write_bytes, write_text
from acquisition.io.places import OutputFolder
from acquisition.limits import Count, Limit
from noise import SonarModel
from noise.fitting.threads import one_thread
from noise.store import ModelName
from sonar_gym.curriculum import Curriculum
from sonar_gym.sb3 import SonarVecEnv
from training.agents.evaluate import Rate
from training.agents.zoo.board import BOARD
from training.agents.zoo.checkpoint import load_learner, save_learner
from training.agents.zoo.settings import Tuned, tuned
from training.common.checkpoint import check_same, read_state
from training.common.progress import OnProgress, progress_bars

CARD = Path(__file__).parents[1] / "templates" / "zoo_card.md"
MODEL, README, RESULT = "model.zip", "README.md", "result.json"
CHECKPOINT = "checkpoint.safetensors"  # of an unfinished training
LEGS = 20  # of a training of the tuned length
STREETS_AT_ONCE = 100
TRAINING_SEEDS = 2**31  # streets of training have this seed or a higher one; lower seeds are for evaluation


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym zoo`."""

    algorithm: Annotated[str, tyro.conf.Positional]
    """Name of the algorithm: ppo, ppo_lstm (recurrent); sac and tqc with hindsight replay on the goal environment."""
    out: OutputFolder
    """Folder for model.zip, README.md, result.json and tensorboard/, and a checkpoint while training is unfinished."""
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


def make_envs(env_id: str, count: int, sonar: str | SonarModel) -> VecEnv:
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


class Training:
    """A training in legs.

    Args:
        args: settings of the command.
        settings: tuned settings.
        on_progress: called with task, steps done and steps in total.
        sonar: sonar model, instead of the one that `args` names.

    Attributes:
        model: the learner.
        leg: number of complete legs.
        seconds: processor time of the complete legs, s.
    """

    def __init__(
        self,
        args: Args,
        settings: Tuned,
        on_progress: OnProgress = lambda name, done, total: None,
        sonar: SonarModel | None = None,
    ) -> None:
        self.args, self.leg, self.seconds = args, 0, 0.0
        self.steps = settings.n_timesteps if args.steps is None else args.steps
        self.leg_steps = math.ceil(settings.n_timesteps / LEGS)
        keywords = {name: value for name, value in settings.keywords.items() if name != "policy"}
        self.envs = make_envs(args.env, settings.n_envs, sonar or args.sonar)
        self.model = settings.algorithm_class(
            settings.keywords["policy"], self.envs, seed=args.seed, device="cpu", **keywords
        )
        self.callbacks: list[BaseCallback] = [_Report(on_progress, self.steps), *settings.make_callbacks()]

    @property
    def path(self) -> Path:
        """Path of the checkpoint."""
        return self.args.out / CHECKPOINT

    @property
    def fixed(self) -> dict[str, Any]:
        """Settings that must not change when a training is continued."""
        return {name: value for name, value in asdict(self.args).items() if name not in ("out", "steps", "episodes")}

    def resume(self) -> None:
        """Load the checkpoint if there is one."""
        if self.path.exists():
            state = read_state(self.path)
            check_same(self.path, self.fixed, state["settings"])
            load_learner(self.path, self.model, self.callbacks, state)
            self.leg, self.seconds = int(state["leg"]), float(state["seconds"])

    def run(self, after_leg: Callable[[], None] = lambda: None) -> BaseAlgorithm:
        """Run the remaining legs, with a checkpoint and a call of `after_leg` after each; losses go to TensorBoard."""
        board = self.args.out / BOARD / f"{self.args.algorithm}_{self.args.seed}"
        self.model.set_logger(configure(str(board), ["tensorboard"]))
        while self.model.num_timesteps < self.steps:
            begin = time.process_time()
            self._begin_leg()
            remaining = self.steps - self.model.num_timesteps
            self.model.learn(min(self.leg_steps, remaining), self.callbacks, reset_num_timesteps=False)
            self.leg, self.seconds = self.leg + 1, self.seconds + time.process_time() - begin
            state = {"settings": self.fixed, "leg": self.leg, "seconds": self.seconds}
            save_learner(self.path, self.model, self.callbacks, state)
            after_leg()
        self.envs.close()
        return self.model

    def _begin_leg(self) -> None:
        """Begin new episodes, with the streets and random numbers of a leg."""
        streets, chance = np.random.SeedSequence([self.args.seed, self.leg]).generate_state(2).tolist()
        self.model.set_random_seed(chance)
        self.envs.seed(TRAINING_SEEDS + streets // 2)
        for curriculum in (one for one in self.callbacks if isinstance(one, Curriculum)):
            self.envs.set_attr("street_settings", curriculum.streets)
        self.model._last_obs = None
        buffer = getattr(self.model, "replay_buffer", None)
        if isinstance(buffer, HerReplayBuffer):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # Stable-Baselines3 warns of what is intended here
                buffer.truncate_last_trajectory()


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


def save_model(model: BaseAlgorithm, path: Path) -> None:
    """Write a model into a file atomically."""
    data = io.BytesIO()
    model.save(data)
    write_bytes(path, data.getvalue())


def write(args: Args, settings: Tuned, model: BaseAlgorithm, rate: Rate, seconds: float) -> None:
    """Write model, card and result into the folder."""
    save_model(model, args.out / MODEL)
    result = {
        **{name: value for name, value in asdict(args).items() if name != "out"},
        "steps": model.num_timesteps,
        "seconds": round(seconds, 1),
        "parked": rate.count,
        "share": rate.share,
        "interval": rate.interval,
    }
    write_text(args.out / RESULT, json.dumps(result, indent=2) + "\n")
    names = {**settings.keywords, **settings.callbacks}
    fields = {
        **result,
        "class_name": type(model).__name__,
        "package": type(model).__module__.partition(".")[0],
        "rate": rate,
        "environments": settings.n_envs,
    }
    fields["settings"] = "\n".join(f"- `{name}`: {_text(value)}" for name, value in names.items())
    write_text(args.out / README, Template(CARD.read_text(encoding="utf-8")).substitute(fields))


def _text(value: Any) -> Any:
    """Return a setting with classes by their names."""
    if isinstance(value, dict):
        return {name: _text(one) for name, one in value.items()}
    return getattr(value, "__name__", value)


def main(args: Args) -> None:
    """Train, test, write, and print the result."""
    settings = tuned(args.algorithm, args.env)
    with one_thread(), progress_bars() as on_progress:
        training = Training(args, settings, on_progress)
        training.resume()
        model = training.run()
        rate = parked(model, args)
    write(args, settings, model, rate, training.seconds)
    training.path.unlink(missing_ok=True)
    Console(highlight=False, soft_wrap=True).print(
        f"{args.out / MODEL}: parked in {rate} of {rate.trials} unseen streets of {args.env}, "
        f"{model.num_timesteps} steps in {training.seconds:.0f} s of processor time"
    )
