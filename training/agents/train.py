"""Train an agent that parks: imitation of a teacher, then PPO where it is requested (Stable-Baselines3).

Training is divided into legs with a checkpoint after each. To continue an interrupted training, give the same command
again: each leg draws its streets and random numbers from the seed and its own number, so the result is the same agent.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import MinLen
from rich.console import Console
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger, configure
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import set_random_seed
from torch import nn

from acquisition import SettingError
from acquisition.io.files import write_bytes
from acquisition.io.places import Output
from acquisition.limits import Limit, Rate, Seed
from noise.credence import wilson
from noise.fitting.threads import one_thread
from noise.store import ModelName
from sonar_gym.agent import Layer, Policy
from sonar_gym.control.memory import MemorySettings
from sonar_gym.sensing.odometry import OdometryName
from sonar_gym.street.street import Difficulty
from training.agents.imitation import ImitationSettings, imitate
from training.agents.vec_env import AgentVecEnv, EnvSettings, EpisodeResult, settings_of
from training.common.canvas import AFTER, BEFORE, SOFT, Axes, panels
from training.common.checkpoint import check_same, load_checkpoint, read_state, save_checkpoint
from training.common.progress import OnProgress, progress_bars

CHECKPOINT, AGENT, BOARD, CURVE = "checkpoint.safetensors", "agent", "tensorboard", "learning.png"
FIRST_TRAINING_SEED = 2**31  # streets of training have this seed or a higher one; lower seeds are for evaluation
IMITATION_PARTS = 10  # parts of imitation whose episodes are counted separately
MILLION = 1e6


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym train-agent`."""

    out: Annotated[Path, Output("folder", "agent.json")]
    """Folder for checkpoint.safetensors, tensorboard/, and agent/, which `sonar_gym.agent.load_agent` reads."""
    sonars: Annotated[tuple[ModelName, ...], MinLen(1)] = ("ideal", "srf08-mlp", "srf08-lstm", "srf08-hybrid")
    """Names or folders of sonar models; the cars are divided evenly among them."""
    faults: bool = True
    """Whether to add each sonar with 5 % arbitrary readings and 50 mm of scatter in 10 %, for robust agents."""
    odometry: Annotated[tuple[OdometryName, ...], MinLen(1)] = ("exact",)
    """Errors of the odometry: exact, wheels, worn; each with each sonar."""
    difficulty: Annotated[tuple[Difficulty, ...], MinLen(1)] = ("normal",)
    """Difficulties of the streets: easy, normal, hard, manoeuvre; each with each sonar."""
    lessons: Annotated[int, Limit(0, 1_000_000)] = 2000
    """Rounds of imitation, each one decision of every car; 0 for PPO alone."""
    steps: Annotated[int, Limit(0, 10**12)] = 0
    """Environment steps (0.1 s) of PPO after imitation: faster agents, less reliable with other sonars; 0 for none."""
    num_envs: Annotated[int, Limit(1, 65_536)] = 256
    """Number of cars."""
    repeat: Annotated[int, Limit(1, 1000)] = 2
    """Steps for which an action holds."""
    hidden: Annotated[tuple[Annotated[int, Limit(1, 4096)], ...], MinLen(1)] = (256, 128)
    """Widths of the hidden layers."""
    learning_rate: Rate = 1e-4
    """Initial learning rate of PPO; it decays linearly."""
    credence: bool = True
    """Whether the agent observes credence; without it all echoes have equal weight."""
    echo: bool = True
    """Whether the agent observes which sonars received an echo; without it, no echo is one at the maximum range."""
    seed: Seed = 0
    """The same seed gives the same agent."""

    def __post_init__(self) -> None:
        """Raise SettingError for invalid values."""
        if self.lessons == self.steps == 0:
            raise SettingError("--lessons and --steps: expected one of them above 0, got 0 for both")
        kinds = len(self.sonars) * (1 + self.faults) * len(self.odometry) * len(self.difficulty)
        if 0 < self.num_envs < kinds:
            raise SettingError(f"--num-envs: expected at least {kinds}, one for each kind of car, got {self.num_envs}")

    @property
    def settings(self) -> dict[str, Any]:
        """Plain data that must not change when a training is continued; `steps` may."""
        fixed = {name: value for name, value in asdict(self).items() if name not in ("out", "steps")}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in fixed.items()}

    @property
    def env_settings(self) -> list[EnvSettings]:
        """Settings of the kinds of environment."""
        return settings_of(self.sonars, self.odometry, self.difficulty, self.faults)


@dataclass(frozen=True)
class PPOSettings:
    """Settings of PPO (Schulman et al. 2017); lengths are counted in decisions.

    Attributes:
        rollout: decisions of each car between two updates.
        updates: updates per leg.
        max_batch: maximum decisions per optimiser step.
        epochs: passes over the rollouts of an update.
        discount: discount of rewards per decision.
        target_kl: an update stops where the policy's KL divergence exceeds 1.5 times this.
        action_std: initial standard deviation of actions, as a fraction of the maximum.
        value_legs: legs after imitation in which only the value function is trained.
    """

    rollout: int = 64
    updates: int = 8
    max_batch: int = 2048
    epochs: int = 4
    discount: float = 0.995
    target_kl: float = 0.02
    action_std: float = 0.14
    value_legs: int = 1

    def rows(self, num_envs: int) -> int:
        """Return the decisions of each car per optimiser step: a divisor of `rollout`."""
        divisors = (k for k in range(1, self.rollout + 1) if self.rollout % k == 0)
        return max(k for k in divisors if k == 1 or k * num_envs <= self.max_batch)


def make_model(args: Args, envs: AgentVecEnv, ppo: PPOSettings) -> PPO:
    """Return the untrained learner."""
    return PPO(
        "MlpPolicy",
        envs,
        learning_rate=args.learning_rate,
        n_steps=ppo.rollout,
        batch_size=args.num_envs * ppo.rows(args.num_envs),
        n_epochs=ppo.epochs,
        gamma=ppo.discount,
        target_kl=ppo.target_kl,
        policy_kwargs={
            "net_arch": list(args.hidden),
            "activation_fn": nn.Tanh,
            "log_std_init": float(np.log(ppo.action_std if args.lessons else 0.6)),
        },
        device="cpu",
    )


class Training:
    """A training in legs; leg 0 is imitation.

    Args:
        args: settings.
        on_progress: called with task, steps done and steps in total.
        ppo: settings of PPO.
        imitation: settings of imitation; `args.lessons` replaces its number of rounds.
        env_settings: settings of `SonarParkingVectorEnv`, instead of those that `args` gives.
    """

    def __init__(
        self,
        args: Args,
        on_progress: OnProgress = lambda name, done, total: None,
        ppo: PPOSettings | None = None,
        imitation: ImitationSettings | None = None,
        env_settings: Sequence[EnvSettings] | None = None,
    ) -> None:
        self.args, self.ppo, self._on_progress = args, ppo or PPOSettings(), on_progress
        self.imitation = ImitationSettings(**{**asdict(imitation or ImitationSettings()), "rounds": args.lessons})
        self.memory = MemorySettings(credence=args.credence, echo=args.echo)
        set_random_seed(_seeds(args.seed, 0)[1])
        self.envs = AgentVecEnv(args.num_envs, env_settings or args.env_settings, self.memory, args.repeat)
        self.model = make_model(args, self.envs, self.ppo)
        self.history: list[dict[str, Any]] = []
        self._course: list[dict[str, Any]] = []  # results of each part of imitation
        self.leg = 0 if args.lessons else 1
        self.model.set_logger(Logger(None, []))

    @property
    def path(self) -> Path:
        """Path of the checkpoint."""
        return self.args.out / CHECKPOINT

    @property
    def actor_critic(self) -> ActorCriticPolicy:
        """The networks."""
        policy = self.model.policy
        assert isinstance(policy, ActorCriticPolicy)
        return policy

    @property
    def steps(self) -> int:
        """Environment steps of PPO so far."""
        return self.model.num_timesteps * self.args.repeat

    def resume(self) -> bool:
        """Load the checkpoint if there is one; returns whether there was."""
        if not self.path.exists():
            return False
        check_same(self.path, self.args.settings, read_state(self.path)["settings"])
        state = load_checkpoint(self.path, self.actor_critic)
        self.leg, self.history = int(state["leg"]), list(state["history"])
        self.model.num_timesteps, self.model._n_updates = int(state["decisions"]), int(state["updates"])
        return True

    def run(self, after_leg: Callable[[], None] = lambda: None) -> None:
        """Run the remaining legs, with a checkpoint and a call of `after_leg` after each."""
        board = self.args.out / BOARD
        self.model.set_logger(configure(str(board), ["tensorboard"]))
        while self.leg == 0 or self.steps < self.args.steps:
            begin = time.perf_counter()
            self._begin_leg()
            self._imitate() if self.leg == 0 else self._reinforce()
            self._log(time.perf_counter() - begin)
            self.leg += 1
            self._save()
            after_leg()

    def _begin_leg(self) -> None:
        """Seed streets and random numbers of a leg; Stable-Baselines3 uses the global generators."""
        streets, chance = _seeds(self.args.seed, self.leg)
        set_random_seed(chance)
        self.envs.seed(FIRST_TRAINING_SEED + streets % (FIRST_TRAINING_SEED // 2))
        self.envs.ended.clear()
        self.model._last_obs = None

    def _imitate(self) -> None:
        rng = np.random.default_rng(_seeds(self.args.seed, 0)[1])
        imitate(self.actor_critic, self.envs, self.imitation, rng, self._on_round)

    def _on_round(self, done: int, loss: float) -> None:
        rounds = self.imitation.rounds
        self._on_progress("imitation", done, rounds)
        if done % (rounds // 20 or 1) == 0:
            self.model.logger.record("imitation/loss", loss)
            self.model.logger.dump(done)
        if done % (rounds // IMITATION_PARTS or 1) == 0 and done < rounds:
            self._course.append({"steps": done * self.envs.num_envs * self.args.repeat, **self._results()})
            self.envs.ended.clear()  # the results of the leg are those of its last part

    def _reinforce(self) -> None:
        """Run PPO for a leg; the actor is frozen until the value function is trained."""
        frozen = bool(self.args.lessons) and self.leg <= self.ppo.value_legs
        for parameter in actor(self.actor_critic):
            parameter.requires_grad_(not frozen)
        remaining = max(0.05, 1.0 - self.steps / self.args.steps)
        self.model.lr_schedule = lambda _: self.args.learning_rate * (1.0 if frozen else remaining)
        decisions = self.ppo.rollout * self.ppo.updates * self.args.num_envs
        self.model.learn(decisions, callback=self._on_decision, reset_num_timesteps=False)

    def _on_decision(self, _locals: Mapping[str, Any], _globals: Mapping[str, Any]) -> bool:
        total = self.args.steps
        self._on_progress("PPO", min(self.steps, total), total)
        return True

    def _results(self) -> dict[str, Any]:
        """Return the mean results of finished episodes."""
        ended = self.envs.ended or [EpisodeResult(False, False, 0.0, 0)]
        success, collision, score, length = np.mean(ended, axis=0)
        return {
            "episodes": len(self.envs.ended),
            "success": round(float(success), 4),
            "collision": round(float(collision), 4),
            "score": round(float(score), 3),
            "seconds_an_episode": round(0.1 * self.args.repeat * float(length), 2),
        }

    def _log(self, seconds: float) -> None:
        one = {"leg": self.leg, "steps": self.steps, "seconds": round(seconds, 1), **self._results()}
        self.history.append(one if self.leg else {**one, "course": self._course})
        for name in ("success", "collision", "score", "seconds_an_episode"):
            self.model.logger.record(f"episodes/{name}", one[name])
        self.model.logger.dump(self.steps)

    def _save(self) -> None:
        state = {
            "settings": self.args.settings,
            "leg": self.leg,
            "decisions": self.model.num_timesteps,
            "updates": self.model._n_updates,
            "history": self.history,
        }
        save_checkpoint(self.path, self.actor_critic, state)
        self.policy().save(self.args.out / AGENT)
        write_bytes(self.args.out / CURVE, learning_curve(self.history))

    def policy(self) -> Policy:
        """Return the present agent, for use without torch."""
        about = {
            "settings": self.args.settings,
            "steps": self.steps,
            "planned": self.args.steps,
            "history": self.history,
        }
        return Policy(layers(self.actor_critic), self.memory, self.args.repeat, about)


def _seeds(seed: int, leg: int) -> tuple[int, int]:
    """Return the seeds of a leg's streets and of its random numbers."""
    streets, chance = np.random.SeedSequence([seed, leg]).generate_state(2)
    return int(streets), int(chance)


def actor(policy: ActorCriticPolicy) -> list[nn.Parameter]:
    """Return the parameters of the action distribution."""
    nets = (policy.mlp_extractor.policy_net, policy.action_net)
    return [*(p for net in nets for p in net.parameters()), policy.log_std]


def layers(policy: ActorCriticPolicy) -> Sequence[Layer]:
    """Return weights and biases of the network of the mean action, as `Policy` takes them."""
    linear = [m for m in (*policy.mlp_extractor.policy_net, policy.action_net) if isinstance(m, nn.Linear)]
    return [(m.weight.detach().numpy().copy(), m.bias.detach().numpy().copy()) for m in linear]


# ---- the learning curve ----------------------------------------------------------------------------------------------

Points = Sequence[tuple[float, Mapping[str, Any]]]


def learning_curve(history: Sequence[Mapping[str, Any]]) -> bytes:
    """Return success and collision rates with 95 % intervals and episode lengths over environment steps, as PNG.

    Args:
        history: one entry per leg (`Policy.about["history"]`); leg 0, if present, is imitation.
    """
    imitated, points = course(history)
    return panels([partial(_draw_rates, imitated, points), partial(_draw_lengths, imitated, points)], (9.0, 3.4))


def course(history: Sequence[Mapping[str, Any]]) -> tuple[float, Points]:
    """Return the end of imitation and the results with their positions, in million steps of all cars."""
    parts = [part for one in history for part in one.get("course", ())]
    imitated = (parts[-1]["steps"] + parts[0]["steps"]) / MILLION if parts else 0.0
    points = [(one["steps"] / MILLION, one) for one in parts]
    points += [(imitated + one["steps"] / MILLION, one) for one in history]
    return imitated, [(at, one) for at, one in points if one["episodes"]]


def _draw_rates(imitated: float, points: Points, ax: Axes) -> None:
    steps = [at for at, _ in points]
    for name, label, colour in (("success", "parked", AFTER), ("collision", "collided", BEFORE)):
        share = np.array([one[name] for _, one in points])
        ended = np.array([one["episodes"] for _, one in points])
        errors = np.abs(np.array(wilson(np.rint(share * ended), ended)) - share)
        ax.errorbar(steps, 100 * share, yerr=100 * errors, color=colour, marker="o", ms=4, capsize=3, label=label)
    _shade(imitated, ax)
    ax.set(title="During training, with exploration", ylabel="episodes (%)", ylim=(-3, 103))
    ax.legend(loc="center right")


def _draw_lengths(imitated: float, points: Points, ax: Axes) -> None:
    lengths = [one["seconds_an_episode"] for _, one in points]
    ax.plot([at for at, _ in points], lengths, color=SOFT, marker="o", ms=4)
    _shade(imitated, ax)
    ax.set(title="Length of an episode", ylabel="duration (s)", ylim=(0, 1.1 * max(lengths, default=1.0)))


def _shade(imitated: float, ax: Axes) -> None:
    ax.set_xlabel("million steps of 0.1 s, all cars")
    if imitated:
        ax.axvspan(0.0, imitated, color=SOFT, alpha=0.12, lw=0, label="imitation")


# ---- the command -----------------------------------------------------------------------------------------------------


def train(
    args: Args,
    on_progress: OnProgress = lambda name, done, total: None,
    env_settings: Sequence[EnvSettings] | None = None,
) -> Training:
    """Train an agent, or continue; `env_settings` replaces the environments that `args` gives."""
    with one_thread():
        training = Training(args, on_progress, env_settings=env_settings)
        training.resume()
        training.run()
    training.envs.close()
    return training


def main(args: Args) -> None:
    """Train, and print the last results and the agent's folder."""
    with progress_bars() as on_progress:
        last = train(args, on_progress).history[-1]
    Console(highlight=False, soft_wrap=True).print(
        f"{args.out / AGENT}: parked in {100 * last['success']:.1f} % and collided in {100 * last['collision']:.1f} % "
        f"of the last {last['episodes']} training episodes; "
        f"evaluate it with `sonar-gym evaluate-agent --agent {args.out / AGENT}`"
    )
