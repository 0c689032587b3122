"""Learn to park from datasets of `sonar-gym dataset` alone, and count the unseen streets in which the agent parks.

    offline.py clone FOLDER/sonar-parking/parking-ideal-v0
    offline.py iql FOLDER/sonar-parking/*

"clone" is behaviour cloning; "iql" is implicit Q-learning (Kostrikov, Nair, Levine 2022), which clones each action
with the weight exp(3 * advantage). The agent is saved in runs/offline; `sonar-gym evaluate-agent` and `sonar-gym
leaderboard` score it.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import minari
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from sonar_gym.agent import Policy
from sonar_gym.control.memory import MemorySettings, ObservationMemory
from training.agents.evaluate import Rate, evaluate, pool_of

UNSEEN = 1_000_000  # seed of the first street of the test
BATCH, RATE = 256, 3e-4
DISCOUNT, EXPECTILE, SHARPNESS, MAX_WEIGHT = 0.99, 0.8, 3.0, 100.0  # of implicit Q-learning
AVERAGING = 0.005  # share of the new weights in those of the target network


class Decisions(NamedTuple):
    """Decisions of all episodes: observation, action, reward, next observation, whether the episode ended with it."""

    shown: Tensor
    action: Tensor
    reward: Tensor
    after: Tensor
    final: Tensor

    def draw(self) -> "Decisions":
        """Return random decisions, with replacement."""
        rows = torch.randint(len(self.shown), (BATCH,))
        return Decisions(*(part[rows] for part in self))


def read(places: Sequence[str], memory: ObservationMemory) -> Decisions:
    """Return the decisions of datasets; an observation is what the memory of an agent shows."""
    parts, car = [], np.zeros(1, dtype=np.int64)
    for episode in (one for place in places for one in minari.MinariDataset(Path(place) / "data").iterate_episodes()):
        memory.reset(car)
        shown = []
        for k in range(len(episode.actions) + 1):
            memory.update(car, {name: value[k][None] for name, value in episode.observations.items()})
            shown.append(memory.features(car)[0])
        after = np.stack(shown[1:])
        parts.append((np.stack(shown[:-1]), episode.actions, episode.rewards, after, episode.terminations))
    return Decisions(*(torch.from_numpy(np.concatenate(one).astype(np.float32)) for one in zip(*parts, strict=True)))


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Return a perceptron."""
    return nn.Sequential(nn.Linear(inputs, 256), nn.Tanh(), nn.Linear(256, 128), nn.Tanh(), nn.Linear(128, outputs))


class Critic:
    """Values of states, V, and of actions, Q, of a better driver than that of the data, from its actions only."""

    def __init__(self, inputs: int, actions: int) -> None:
        self.value = network(inputs, 1)
        self.quality, self.target = (nn.ModuleList(network(inputs + actions, 1) for _ in range(2)) for _ in range(2))
        self.target.load_state_dict(self.quality.state_dict())
        self.adam = torch.optim.Adam([*self.value.parameters(), *self.quality.parameters()], lr=RATE)

    def weights(self, some: Decisions) -> Tensor:
        """Learn from some decisions, and return the weights of their actions, (n,)."""
        pairs = torch.cat([some.shown, some.action], dim=1)
        value = self.value(some.shown).squeeze(1)
        with torch.no_grad():
            best = torch.stack([one(pairs).squeeze(1) for one in self.target]).amin(0)
            goal = some.reward + DISCOUNT * (1.0 - some.final) * self.value(some.after).squeeze(1)
        advantage = best - value
        loss = (torch.where(advantage > 0.0, EXPECTILE, 1.0 - EXPECTILE) * advantage**2).mean()
        loss = loss + sum(F.mse_loss(one(pairs).squeeze(1), goal) for one in self.quality)
        self.adam.zero_grad()
        loss.backward()
        self.adam.step()
        with torch.no_grad():
            for slow, fast in zip(self.target.parameters(), self.quality.parameters(), strict=True):
                slow.lerp_(fast, AVERAGING)
        return torch.exp(SHARPNESS * advantage.detach()).clamp(max=MAX_WEIGHT)


def main(
    method: str, *places: str, agent: str = "runs/offline", steps: int = 20_000, streets: int = 200, seed: int = 0
) -> Rate:
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    settings = MemorySettings()
    data = read(places, ObservationMemory(1, settings=settings))
    actor = network(data.shown.shape[1], data.action.shape[1])
    critic = Critic(data.shown.shape[1], data.action.shape[1]) if method == "iql" else None
    adam = torch.optim.Adam(actor.parameters(), lr=RATE)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps)
    for _ in range(steps):
        some = data.draw()
        weight = torch.ones(BATCH) if critic is None else critic.weights(some)
        error = F.smooth_l1_loss(actor(some.shown), some.action, beta=0.05, reduction="none").mean(1)
        adam.zero_grad()
        (weight * error).mean().backward()
        adam.step()
        decay.step()
    layers = [(one.weight.detach().numpy(), one.bias.detach().numpy()) for one in actor if isinstance(one, nn.Linear)]
    policy = Policy(layers, settings)
    policy.save(agent)
    rate = evaluate(pool_of(policy), {"threads": 1}, range(UNSEEN, UNSEEN + streets)).successes
    print(f"{method}, seed {seed}: parked in {rate} of {streets} unseen streets, after {len(data.shown)} decisions")
    return rate


if __name__ == "__main__":
    main(*sys.argv[1:])
