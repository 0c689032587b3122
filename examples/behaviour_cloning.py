"""Clone a driver from a dataset of `sonar-gym dataset`, and count the unseen streets in which the clone parks.

usage: behaviour_cloning.py FOLDER/sonar-parking/scripted-ideal-v0 [AGENT]; the clone is saved as an agent, which
`sonar-gym evaluate-agent --agent AGENT` and `sonar-gym leaderboard AGENT` score.
"""

import sys
from pathlib import Path

import minari
import numpy as np
import torch
from torch import nn

from sonar_gym.agent import Policy
from sonar_gym.control.memory import MemorySettings, ObservationMemory
from training.agents.evaluate import evaluate, pool_of

UNSEEN = 1_000_000  # seed of the first street of the test


def remembered(dataset: minari.MinariDataset, memory: ObservationMemory) -> tuple[torch.Tensor, torch.Tensor]:
    """Return what the memory of an agent shows before each action, and the actions."""
    shown, actions, car = [], [], np.zeros(1, dtype=np.int64)
    for episode in dataset.iterate_episodes():
        memory.reset(car)
        for k in range(len(episode.actions)):
            memory.update(car, {name: value[k][None] for name, value in episode.observations.items()})
            shown.append(memory.features(car)[0])
        actions.append(episode.actions)
    return torch.from_numpy(np.stack(shown)), torch.from_numpy(np.concatenate(actions))


def main(place: str, agent: str = "runs/clone", passes: int = 30, streets: int = 200, seed: int = 0) -> float:
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    settings = MemorySettings()
    shown, actions = remembered(minari.MinariDataset(Path(place) / "data"), ObservationMemory(1, settings=settings))
    net = nn.Sequential(nn.Linear(shown.shape[1], 256), nn.Tanh(), nn.Linear(256, 128), nn.Tanh(), nn.Linear(128, 2))
    adam = torch.optim.Adam(net.parameters(), lr=1e-3)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(adam, passes)
    for _ in range(passes):
        for rows in torch.randperm(len(shown)).split(1024):
            loss = nn.functional.smooth_l1_loss(net(shown[rows]), actions[rows], beta=0.05)
            adam.zero_grad()
            loss.backward()
            adam.step()
        decay.step()
    layers = [(one.weight.detach().numpy(), one.bias.detach().numpy()) for one in net if isinstance(one, nn.Linear)]
    policy = Policy(layers, settings)
    policy.save(agent)
    share = float(evaluate(pool_of(policy), {"threads": 1}, range(UNSEEN, UNSEEN + streets)).success.mean())
    print(f"{agent}: parked in {share:.1%} of {streets} unseen streets, after {len(shown)} decisions of {place}")
    return share


if __name__ == "__main__":
    main(*sys.argv[1:])
