"""Train an agent that parks: first it imitates a teacher, then it learns by itself (PPO of Stable-Baselines3).

Killed, it goes on where its last checkpoint was: give the same command again. Each leg of the training begins with
streets and chances drawn from the seed and its own number, so a training that was killed comes to the same agent.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, configure
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import set_random_seed
from torch import nn

from acquisition import SettingError
from acquisition.io.files import write_bytes
from noise.fitting.threads import one_thread
from sonar_gym.agent import Layer, Policy
from sonar_gym.control.memory import MemorySettings
from training.agents.imitation import Lessons, imitate
from training.agents.learning_curve import learning_curve
from training.agents.worlds import AgentVecEnv, Ended, World, worlds_of
from training.common.checkpoint import check_same, load_checkpoint, read_state, save_checkpoint
from training.common.progress import bars

CHECKPOINT, AGENT, BOARD, CURVE = "checkpoint.safetensors", "agent", "tensorboard", "learning.png"
UNSEEN = 2**31  # training draws its streets from seeds of this and more; those below are for evaluation
TENTHS = 10  # of imitation whose episodes are counted apart
Tell = Callable[[str, int, int], None]  # what is being done, how much of it, and of how much


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym train-agent`."""

    out: Path
    """Folder to write: checkpoint.safetensors, tensorboard/, and agent/, which `sonar_gym.agent.load_agent` reads."""
    sonars: tuple[str, ...] = ("ideal", "srf08-mlp", "srf08-lstm", "srf08-hybrid")
    """Names or folders of the models to learn with; cars are shared out evenly among them."""
    faults: bool = True
    """Whether to learn with each also when 5 % of its readings tell of things that are not there and 10 % scatter by
    50 mm: what makes a driver cope with sonars that it has never heard."""
    odometry: tuple[str, ...] = ("exact",)
    """How far off the car's knowledge of its way is: exact, wheels, worn; each with each sonar."""
    difficulty: tuple[str, ...] = ("normal",)
    """Of the streets: easy, normal, hard; each with each sonar."""
    lessons: int = 2000
    """Rounds of imitation, each a decision of every car; 0 to learn by trial alone."""
    steps: int = 0
    """Steps of 0.1 s of the environments to learn from by trial after that, as 1000000; it makes agents quicker, and
    less careful where they have met few sonars. 0 for imitation alone."""
    num_envs: int = 256
    """Cars that drive at the same time."""
    repeat: int = 2
    """Steps for which a decision holds."""
    hidden: tuple[int, ...] = (256, 128)
    """Widths of the hidden layers."""
    learning_rate: float = 1e-4
    """Of PPO, at its highest; it falls along a straight line."""
    credence: bool = True
    """Whether the agent is told credence; without, every echo counts alike."""
    seed: int = 0
    """Same seed, same agent."""

    def __post_init__(self) -> None:
        """Refuse what trains nothing."""
        if min(self.lessons, self.steps) < 0 or self.lessons + self.steps == 0:
            raise SettingError(f"lessons {self.lessons} and steps {self.steps} must be >= 0, and one of them > 0")
        kinds = len(self.sonars) * (1 + self.faults) * len(self.odometry) * len(self.difficulty)
        if not 0 < kinds <= self.num_envs:
            raise SettingError(f"{self.num_envs} cars for {kinds} kinds of world: give one or more for each")

    @property
    def settings(self) -> dict[str, Any]:
        """Plain data that a training must be gone on with unchanged; its length may be another."""
        kept = {name: value for name, value in asdict(self).items() if name not in ("out", "steps")}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in kept.items()}

    @property
    def worlds(self) -> list[World]:
        """The kinds of world that it learns in."""
        return worlds_of(self.sonars, self.odometry, self.difficulty, self.faults)


@dataclass(frozen=True)
class Trials:
    """How the agent learns by trial: settings of PPO (Schulman et al. 2017), in decisions.

    Attributes:
        length: decisions of each car between two updates.
        updates: in a leg, after which there is a checkpoint.
        batch: most decisions a step of the optimiser.
        epochs: passes over what was just gone through.
        discount: of rewards, a decision.
        target_kl: an update stops where the policy has changed by half as much again.
        spread: standard deviation of actions at first, as a share of the greatest.
        watching: legs in which only the value of states is learned, after imitation.
    """

    length: int = 64
    updates: int = 8
    batch: int = 2048
    epochs: int = 4
    discount: float = 0.995
    target_kl: float = 0.02
    spread: float = 0.14
    watching: int = 1

    def rows(self, num_envs: int) -> int:
        """Return how many decisions of each car make a step of the optimiser: a divisor of `length`."""
        return max(
            k for k in range(1, self.length + 1) if self.length % k == 0 and (k == 1 or k * num_envs <= self.batch)
        )


def make_model(args: Args, envs: AgentVecEnv, trials: Trials) -> PPO:
    """Return the learner, untrained."""
    return PPO(
        "MlpPolicy",
        envs,
        learning_rate=args.learning_rate,
        n_steps=trials.length,
        batch_size=args.num_envs * trials.rows(args.num_envs),
        n_epochs=trials.epochs,
        gamma=trials.discount,
        target_kl=trials.target_kl,
        policy_kwargs={
            "net_arch": list(args.hidden),
            "activation_fn": nn.Tanh,
            "log_std_init": float(np.log(trials.spread if args.lessons else 0.6)),
        },
        device="cpu",
    )


class _Steps(BaseCallback):
    """Tells how far a leg is."""

    def __init__(self, tell: Callable[[int], None]) -> None:
        super().__init__()
        self._tell = tell

    def _on_step(self) -> bool:
        self._tell(self.num_timesteps)
        return True


class Training:
    """A training, leg by leg; leg 0 is imitation.

    Args:
        args: settings.
        tell: of progress.
        trials: how it learns by trial.
        lessons: how it is taught; `args.lessons` rounds of it.
        worlds: settings of `SonarParkingVectorEnv`, in the place of those that `args` names.
    """

    def __init__(
        self,
        args: Args,
        tell: Tell = lambda what, done, of: None,
        trials: Trials | None = None,
        lessons: Lessons | None = None,
        worlds: Sequence[World] | None = None,
    ) -> None:
        self.args, self.trials, self._tell = args, trials or Trials(), tell
        self.lessons = Lessons(**{**asdict(lessons or Lessons()), "rounds": args.lessons})
        self.memory = MemorySettings(credence=args.credence)
        set_random_seed(_seeds(args.seed, 0)[1])
        self.envs = AgentVecEnv(args.num_envs, worlds or args.worlds, self.memory, args.repeat)
        self.model = make_model(args, self.envs, self.trials)
        self.history: list[dict[str, Any]] = []
        self._course: list[dict[str, Any]] = []  # of imitation, a tenth of it an entry; begun anew with it
        self.leg = 0 if args.lessons else 1
        self.model.set_logger(Logger(None, []))

    @property
    def path(self) -> Path:
        """Of the checkpoint."""
        return self.args.out / CHECKPOINT

    @property
    def actor_critic(self) -> ActorCriticPolicy:
        """The networks."""
        policy = self.model.policy
        assert isinstance(policy, ActorCriticPolicy)
        return policy

    @property
    def steps(self) -> int:
        """Of the environments, learned from by trial so far."""
        return self.model.num_timesteps * self.args.repeat

    def resume(self) -> bool:
        """Go on from the checkpoint where there is one; returns whether there was."""
        if not self.path.exists():
            return False
        check_same(self.path, self.args.settings, read_state(self.path)["settings"])
        state = load_checkpoint(self.path, self.actor_critic)
        self.leg, self.history = int(state["leg"]), list(state["history"])
        self.model.num_timesteps, self.model._n_updates = int(state["decisions"]), int(state["updates"])
        return True

    def run(self, after: Callable[[], None] = lambda: None) -> None:
        """Do the legs that are left, with a checkpoint after each, and call `after` then."""
        board = self.args.out / BOARD
        self.model.set_logger(configure(str(board), ["tensorboard"]))
        while self.leg == 0 or self.steps < self.args.steps:
            begin = time.perf_counter()
            self._begin_leg()
            self._imitate() if self.leg == 0 else self._try()
            self._note(time.perf_counter() - begin)
            self.leg += 1
            self._save()
            after()

    def _begin_leg(self) -> None:
        """Begin with streets and chances of the leg's own; Stable-Baselines3 draws from the global generators."""
        streets, chance = _seeds(self.args.seed, self.leg)
        set_random_seed(chance)
        self.envs.seed(UNSEEN + streets % (UNSEEN // 2))
        self.envs.ended.clear()
        self.model._last_obs = None

    def _imitate(self) -> None:
        rounds = self.lessons.rounds
        rng = np.random.default_rng(_seeds(self.args.seed, 0)[1])

        def tell(done: int, loss: float) -> None:
            self._tell("imitation", done, rounds)
            if done % (rounds // 20 or 1) == 0:
                self.model.logger.record("imitation/loss", loss)
                self.model.logger.dump(done)
            if done % (rounds // TENTHS or 1) == 0 and done < rounds:
                self._course.append({"steps": done * self.envs.num_envs * self.args.repeat, **self._ended()})
                self.envs.ended.clear()  # what is noted of the leg itself is how it ended

        imitate(self.actor_critic, self.envs, self.lessons, rng, tell)

    def _try(self) -> None:
        """Learn by trial for a leg; what was imitated is left alone until the value of states is known."""
        watching = bool(self.args.lessons) and self.leg <= self.trials.watching
        for parameter in actor(self.actor_critic):
            parameter.requires_grad_(not watching)
        left = max(0.05, 1.0 - self.steps / self.args.steps)
        self.model.lr_schedule = lambda _: self.args.learning_rate * (1.0 if watching else left)
        decisions = self.trials.length * self.trials.updates * self.args.num_envs
        total, repeat = self.args.steps, self.args.repeat
        callback = _Steps(lambda done: self._tell("trial", min(done * repeat, total), total))
        self.model.learn(decisions, callback=callback, reset_num_timesteps=False)

    def _ended(self) -> dict[str, Any]:
        """Return what the episodes came to that are over."""
        ended = self.envs.ended or [Ended(False, False, 0.0, 0)]
        success, collision, score, length = np.mean(ended, axis=0)
        return {
            "episodes": len(self.envs.ended),
            "success": round(float(success), 4),
            "collision": round(float(collision), 4),
            "score": round(float(score), 3),
            "seconds_an_episode": round(0.1 * self.args.repeat * float(length), 2),
        }

    def _note(self, seconds: float) -> None:
        one = {"leg": self.leg, "steps": self.steps, "seconds": round(seconds, 1), **self._ended()}
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

    def policy(self, card: str = "") -> Policy:
        """Return the agent as it is now, for use without torch."""
        about = {
            "settings": self.args.settings,
            "steps": self.steps,
            "planned": self.args.steps,
            "history": self.history,
        }
        return Policy(layers(self.actor_critic), self.memory, self.args.repeat, about, card)


def _seeds(seed: int, leg: int) -> tuple[int, int]:
    """Return seeds of a leg's streets and of its chances."""
    streets, chance = np.random.SeedSequence([seed, leg]).generate_state(2)
    return int(streets), int(chance)


def actor(policy: ActorCriticPolicy) -> list[nn.Parameter]:
    """Return the parameters on which actions depend."""
    nets = (policy.mlp_extractor.policy_net, policy.action_net)
    return [*(p for net in nets for p in net.parameters()), policy.log_std]


def layers(policy: ActorCriticPolicy) -> Sequence[Layer]:
    """Return the layers between what is shown and the mean action, as `Policy` wants them."""
    linear = [m for m in (*policy.mlp_extractor.policy_net, policy.action_net) if isinstance(m, nn.Linear)]
    return [(m.weight.detach().numpy().copy(), m.bias.detach().numpy().copy()) for m in linear]


def train(args: Args, tell: Tell = lambda what, done, of: None, worlds: Sequence[World] | None = None) -> Training:
    """Train an agent, or go on with it; in other worlds than `args` names, where some are given."""
    with one_thread():
        training = Training(args, tell, worlds=worlds)
        training.resume()
        training.run()
    training.envs.close()
    return training


def main(args: Args) -> None:
    """Train, and say how it went and where the agent is."""
    console = Console(highlight=False, soft_wrap=True)
    with bars() as progress:
        tasks: dict[str, Any] = {}

        def tell(what: str, done: int, of: int) -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=of)
            progress.update(tasks[what], completed=done, total=of)

        training = train(args, tell)
    last = training.history[-1]
    console.print(
        f"{args.out / AGENT}: parked in {100 * last['success']:.1f} % of the last {last['episodes']} episodes of its "
        f"training, touched something in {100 * last['collision']:.1f} %; "
        f"look at it with `sonar-gym evaluate-agent --agent {args.out / AGENT}`"
    )
