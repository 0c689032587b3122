"""Train SAC with hindsight experience replay on the parking lot of highway-env with realistic sonars."""

import sys

import gymnasium
import highway_env  # noqa: F401 - registers parking-v0
import numpy as np
import torch
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm

from sonar_gym import SonarObservation

SECONDS = 15  # length of an episode; five decisions per second
EPISODES = 20  # evaluation episodes before and after training


def make(seed: int) -> gymnasium.Env:
    """Return the parking lot, with the readings of eight sonars and their credence in addition to its observation."""
    env = SonarObservation(gymnasium.make("parking-v0", config={"duration": SECONDS}), "gaussian")
    env.reset(seed=seed)
    return env


def score(model: BaseAlgorithm, env: gymnasium.Env) -> np.ndarray:
    """Return the mean reward per decision on each of the evaluation lots; 0 is parked."""
    means = []
    for seed in range(1000, 1000 + EPISODES):
        observation, _ = env.reset(seed=seed)
        rewards, over = [], False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(model.predict(observation, deterministic=True)[0])
            rewards.append(float(reward))
            over = terminated or truncated
        means.append(np.mean(rewards))
    return np.array(means)


def main(steps: int = 6000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    torch.set_num_threads(1)
    env = make(seed)
    settings = {"learning_rate": 1e-3, "gamma": 0.95, "learning_starts": 500, "policy_kwargs": {"net_arch": [256, 256]}}
    # hindsight experience replay changes the goals only; the readings of the sonars are unchanged
    model = SAC("MultiInputPolicy", env, seed=seed, device="cpu", replay_buffer_class=HerReplayBuffer, **settings)
    before = score(model, env)
    model.learn(steps, progress_bar=sys.stderr.isatty())
    after = score(model, env)
    won = after - before
    error = won.std(ddof=1) / np.sqrt(len(won))
    print(f"reward per decision on {EPISODES} unseen lots: {before.mean():.3f} before, {after.mean():.3f} after")
    print(f"gain {won.mean():.3f} +- {error:.3f} (standard error, paired) in {steps} decisions")
    env.close()
    return before, after


if __name__ == "__main__":
    main()
