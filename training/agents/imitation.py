"""First lessons of an agent: it imitates the teacher, more and more on the ways that it goes itself.

Dataset aggregation (Ross, Gordon and Bagnell 2011, "A reduction of imitation learning to no-regret online learning"):
episodes are driven by the teacher at first and by the agent later, and what the teacher would have done is learned
everywhere. The loss grows with the size of an error, not with its square: where two actions are as good, the network
takes one of them instead of their mean, which may be to stand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy
from torch.nn import functional as F

from training.agents.teacher import Teacher
from training.agents.worlds import AgentVecEnv

Singles = NDArray[np.float32]
BETA = 0.05  # of the loss: errors smaller than this are squared
FALL = 0.03  # the learning rate falls to this share of the first along a straight line


@dataclass(frozen=True)
class Lessons:
    """How the agent is taught.

    Attributes:
        rounds: decisions of every car that the teacher comments on.
        guided: share of the rounds in which, ever less often, the teacher drives itself.
        kept: comments that are kept; later ones take the place of the first.
        batches: steps of the optimiser a round.
        batch: comments a step.
        learning_rate: of Adam, at its highest.
    """

    rounds: int = 3000
    guided: float = 0.2
    kept: int = 300_000
    batches: int = 2
    batch: int = 1024
    learning_rate: float = 1e-3


class Comments:
    """What was shown to the agent, and what the teacher would have done; the last so many.

    Args:
        kept: how many.
        shown: numbers that the agent is shown.
        actions: numbers that it answers.
    """

    def __init__(self, kept: int, shown: int, actions: int) -> None:
        self._shown = np.zeros((kept, shown), dtype=np.float32)
        self._action = np.zeros((kept, actions), dtype=np.float32)
        self.count = 0

    def add(self, shown: Singles, action: NDArray[np.float64]) -> None:
        """Keep comments, (n, shown) and (n, actions)."""
        place = np.arange(self.count, self.count + len(shown)) % len(self._shown)
        self._shown[place], self._action[place] = shown, action
        self.count += len(shown)

    def draw(self, count: int, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Return some of what is kept."""
        rows = rng.integers(0, min(self.count, len(self._shown)), count)
        return torch.from_numpy(self._shown[rows]), torch.from_numpy(self._action[rows])


def mean_action(policy: ActorCriticPolicy, shown: torch.Tensor) -> torch.Tensor:
    """Return what a policy would do without chance, (n, 2)."""
    features = policy.extract_features(shown, policy.pi_features_extractor)
    assert isinstance(features, torch.Tensor)
    latent = policy.mlp_extractor.forward_actor(features)
    wanted: torch.Tensor = policy.action_net(latent)
    return wanted


def imitate(
    policy: ActorCriticPolicy,
    envs: AgentVecEnv,
    lessons: Lessons,
    rng: np.random.Generator,
    tell: Callable[[int, float], None] = lambda done, loss: None,
) -> None:
    """Teach a policy.

    Args:
        policy: whose actions are to be the teacher's.
        envs: the cars; seeded.
        lessons: how.
        rng: of who drives, and of which comments are learned from.
        tell: called after each round with the number of rounds and the last loss.
    """
    teachers = [Teacher(venv.envs.fleet) for venv in envs.venvs]
    comments = Comments(max(lessons.kept, envs.num_envs), envs.memory.size, envs.action_space.shape[0])  # type: ignore[index]
    actor = [*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters()]
    adam = torch.optim.Adam(actor, lr=lessons.learning_rate)
    shown, guided = np.asarray(envs.reset()), np.ones(envs.num_envs, dtype=np.bool_)
    for done in range(lessons.rounds):
        ways = (envs.memory.way[part] for part in envs.parts)
        advice = np.concatenate([teacher.act(way) for teacher, way in zip(teachers, ways, strict=True)])
        comments.add(shown, advice)
        with torch.no_grad():
            own = np.clip(mean_action(policy, torch.from_numpy(shown)).numpy(), -1.0, 1.0)
        shown, _, over, _ = envs.advance(np.where(guided[:, None], advice, own).astype(np.float32))
        share = max(0.0, 1.0 - done / (lessons.guided * lessons.rounds))
        guided[over] = rng.random(int(over.sum())) < share
        adam.param_groups[0]["lr"] = lessons.learning_rate * max(FALL, 1.0 - done / lessons.rounds)
        loss = [_learn(policy, adam, *comments.draw(lessons.batch, rng)) for _ in range(lessons.batches)][-1]
        tell(done + 1, loss)


def _learn(policy: ActorCriticPolicy, adam: torch.optim.Adam, shown: torch.Tensor, advice: torch.Tensor) -> float:
    loss = F.smooth_l1_loss(mean_action(policy, shown), advice, beta=BETA)
    adam.zero_grad()
    loss.backward()
    adam.step()
    return float(loss.detach())
