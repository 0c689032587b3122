"""Speed and memory of the environment, compared with highway-env in the same run.

Run by `make benchmarks`; prints Markdown for docs/reference/environment.md. Environments are timed in alternating
rounds, so that other load affects both. Results with one thread are processor times; set OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import os
import subprocess
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import gymnasium
import highway_env
import numpy as np
import pytest

import sonar_gym
from sonar_gym.control.driver import ParkingDriver, run_episode
from sonar_gym.parking.vector import SonarParkingVectorEnv, cores
from sonar_gym.sb3 import SonarVecEnv

SONARS = ("ideal", "gaussian", "srf08-mlp", "srf08-lstm")
ROUNDS, STEPS, EPISODES = 12, 100, 100
MANY, MANY_STEPS, MANY_ROUNDS = 1024, 30, 8
Clock = Callable[[], float]
LIDAR = {"observation": {"type": "LidarObservation", "cells": 8, "maximum_range": 6.0}}


@pytest.fixture(scope="module", autouse=True)
def commit() -> None:
    gymnasium.register_envs(highway_env)
    result = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    load = os.getloadavg()[1] if hasattr(os, "getloadavg") else float("nan")
    print(f"\ncommit {result.stdout.strip()}, {cores()} processors, load {load:.1f}; `make benchmarks`\n")


def step_seconds(env: gymnasium.Env, steps: int) -> float:
    """Return the processor time per step of an environment with random actions, s."""
    env.action_space.seed(0)
    env.reset(seed=0)
    start = time.process_time()
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
    return (time.process_time() - start) / steps


def paired(env: gymnasium.Env, reference: gymnasium.Env, steps: int, reference_steps: int) -> np.ndarray:
    """Return the times per step of two environments, round by round, s, (ROUNDS, 2)."""
    step_seconds(env, 20), step_seconds(reference, 5)
    return np.array([(step_seconds(env, steps), step_seconds(reference, reference_steps)) for _ in range(ROUNDS)])


def test_speed_of_a_single_environment() -> None:
    reference, lidar = gymnasium.make("parking-v0"), gymnasium.make("parking-v0", config=LIDAR)
    print("| sonar | steps per second | relative to highway-env parking-v0 | with its lidar |\n|---|---|---|---|")
    for name in SONARS:
        env = gymnasium.make(sonar_gym.ENV_ID, sonar=name)
        without_lidar, lidar_pairs = (paired(env, other, STEPS, STEPS // 5) for other in (reference, lidar))
        ratio, with_lidar = (np.median(pairs[:, 1] / pairs[:, 0]) for pairs in (without_lidar, lidar_pairs))
        print(f"| {name} | {1 / np.median(without_lidar[:, 0]):.0f} | {ratio:.1f} | {with_lidar:.1f} |")
        assert ratio > 1.0


def vector_step_seconds(envs: SonarParkingVectorEnv | SonarVecEnv, actions: np.ndarray, clock: Clock) -> float:
    """Return the time per step and environment of a vector environment, s."""
    start = clock()
    for action in actions:
        envs.step(action)
    return (clock() - start) / actions[..., 0].size


@pytest.mark.timeout(1800)
def test_speed_of_a_vector_environment() -> None:
    reference = gymnasium.make("parking-v0")
    rng = np.random.default_rng(0)
    actions = rng.uniform([-0.6, -0.8], [0.6, 1.0], (MANY_STEPS, MANY, 2)).astype(np.float32)
    print(
        f"\n| sonar, {MANY} at once | threads, clock | steps per second, median | best round | relative to parking-v0 |"
    )
    print("|---|---|---|---|---|")
    for name in SONARS:
        for threads, clock in ((1, time.process_time), (cores(), time.perf_counter)):
            envs = SonarParkingVectorEnv(MANY, sonar=name, threads=threads)
            envs.reset(seed=0), vector_step_seconds(envs, actions[:5], clock)
            pairs = np.array(
                [(vector_step_seconds(envs, actions, clock), step_seconds(reference, 10)) for _ in range(MANY_ROUNDS)]
            )
            envs.close()
            median, best = 1 / np.median(pairs[:, 0]), 1 / pairs[:, 0].min()
            ratio = np.median(pairs[:, 1] / pairs[:, 0])
            print(f"| {name} | {threads}, {clock.__name__} | {median:.0f} | {best:.0f} | {ratio:.0f} |")
            assert ratio > 10.0


def test_speed_with_stable_baselines() -> None:
    rng = np.random.default_rng(0)
    print("\n| sonar, `SonarVecEnv` | environments | steps per second, median | best round |\n|---|---|---|---|")
    for name in ("ideal", "srf08-mlp"):
        for count in (16, 64, 256):
            envs = SonarVecEnv(count, sonar=name, threads=1)
            actions = rng.uniform([-0.6, -0.8], [0.6, 1.0], (8192 // count, count, 2)).astype(np.float32)
            envs.reset(), vector_step_seconds(envs, actions[:5], time.process_time)
            times = [vector_step_seconds(envs, actions, time.process_time) for _ in range(MANY_ROUNDS)]
            envs.close()
            print(f"| {name} | {count} | {1 / np.median(times):.0f} | {1 / np.min(times):.0f} |")
            assert np.median(times) < 1e-3


def test_memory_of_an_environment() -> None:
    print("\n| sonar, layout | kB per environment |\n|---|---|")
    for name, layout in [*((name, "eight") for name in SONARS), ("gaussian", "eight in turn")]:
        SonarParkingVectorEnv(1, sonar=name, sonar_layout=layout, threads=1).close()  # fills the caches of credence
        memory = []
        for count in (64, 64 + MANY):
            tracemalloc.start()
            envs = SonarParkingVectorEnv(count, sonar=name, sonar_layout=layout, threads=1)
            envs.reset(seed=0), envs.step(np.zeros((count, 2)))
            memory.append(tracemalloc.get_traced_memory()[0])
            tracemalloc.stop()
            envs.close()
        per_env = (memory[1] - memory[0]) / MANY / 1000
        print(f"| {name}, {layout} | {per_env:.1f} |")
        assert per_env < 16.0


class Stopwatch(gymnasium.Wrapper):
    """Records the times of steps, s."""

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.step_s: list[float] = []

    def step(self, action: Any) -> Any:
        """Step and record the time."""
        start = time.process_time()
        outcome = self.env.step(action)
        self.step_s.append(time.process_time() - start)
        return outcome


@pytest.mark.parametrize("sonar", ["ideal", "gaussian", "srf08-mlp"])
@pytest.mark.parametrize("name", ["parking-v0", "highway-v0"])
def test_relative_time_of_the_wrapper(name: str, sonar: str) -> None:
    """Measure the time of the wrapper relative to that of the environment within each step."""
    inner = Stopwatch(gymnasium.make(name))
    outer = Stopwatch(sonar_gym.SonarObservation(inner, sonar))
    step_seconds(outer, 200 if name == "parking-v0" else 12)
    inner_s, outer_s = np.array(inner.step_s), np.array(outer.step_s)
    added = np.median((outer_s - inner_s) / inner_s)
    print(f"\n`{sonar}` adds {100 * added:.1f} % to a step of {name}, which takes {1e3 * np.median(inner_s):.1f} ms")
    assert added <= 0.10


def test_success_of_the_scripted_driver() -> None:
    print("\n| sonar | parked | collided | streets |\n|---|---|---|---|")
    for name in SONARS:
        env = gymnasium.make(sonar_gym.ENV_ID, sonar=name)
        episodes = [run_episode(env, ParkingDriver(), seed) for seed in range(EPISODES)]
        parked, hit = sum(e.success for e in episodes), sum(e.collision for e in episodes)
        print(f"| {name} | {parked} | {hit} | {EPISODES} |")
        assert parked >= 0.9 * EPISODES
