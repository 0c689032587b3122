"""How fast the environment steps, beside highway-env's parking in the same run, and how often the driver parks.

Run by `make benchmarks`; prints Markdown for docs/environment.md.
"""

from __future__ import annotations

import subprocess
import time

import gymnasium
import highway_env
import numpy as np
import pytest

import sonar_gym
from sonar_gym.driver import ParkingDriver, run_episode

SONARS = ("ideal", "gaussian", "srf08-mlp")
ROUNDS, STEPS, EPISODES = 12, 100, 100


@pytest.fixture(scope="module", autouse=True)
def commit() -> None:
    done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    print(f"\ncommit {done.stdout.strip()}, command `make benchmarks`\n")


def seconds(env: gymnasium.Env, steps: int) -> float:
    env.action_space.seed(0)
    env.reset(seed=0)
    start = time.perf_counter()
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
    return time.perf_counter() - start


def test_steps_beside_highway_env() -> None:
    gymnasium.register_envs(highway_env)
    peer = gymnasium.make("parking-v0")
    envs = {name: gymnasium.make(sonar_gym.ENV_ID, sonar=name) for name in SONARS}
    for env in (peer, *envs.values()):
        seconds(env, 20)
    print("| sonar | steps a second, median | times highway-env parking-v0, median of paired rounds |\n|---|---|---|")
    peer_steps = STEPS // 4
    for name, env in envs.items():
        pairs = np.array([(seconds(env, STEPS) / STEPS, seconds(peer, peer_steps) / peer_steps) for _ in range(ROUNDS)])
        print(f"| {name} | {1 / np.median(pairs[:, 0]):.0f} | {np.median(pairs[:, 1] / pairs[:, 0]):.1f} |")
        assert np.median(pairs[:, 1] / pairs[:, 0]) > 1.0


def test_how_often_the_driver_parks() -> None:
    print("\n| sonar | parked | collided | streets |\n|---|---|---|---|")
    for name in SONARS:
        env = gymnasium.make(sonar_gym.ENV_ID, sonar=name)
        episodes = [run_episode(env, ParkingDriver(), seed) for seed in range(EPISODES)]
        parked, hit = sum(e.success for e in episodes), sum(e.collision for e in episodes)
        print(f"| {name} | {parked} | {hit} | {EPISODES} |")
        assert parked >= 0.9 * EPISODES
