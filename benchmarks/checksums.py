"""Checksums of what fixed seeds give: readings, observations, recordings, trained weights, a diagnosis.

Written through public names and commands alone, so that it runs unchanged before and after code is moved or renamed:

    python benchmarks/checksums.py > before.json
    python benchmarks/checksums.py --against before.json

Floating-point sums differ between processors, so both runs are made on one machine, and no record is kept here.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import highway_env
import numpy as np
import pandas as pd

import noise
import sonar_gym
from acquisition import Ping
from sonar_gym.agent import load_agent
from sonar_gym.sb3 import SonarVecEnv

MODELS = ("ideal", "gaussian", "srf08-mlp", "srf08-lstm", "srf08-hybrid", "rig")
COMMAND = [sys.executable, "-c", "from training.cli import main; main()"]


class Digest:
    """A SHA-256 over arrays, mappings and sequences of arrays."""

    def __init__(self) -> None:
        self._sha = hashlib.sha256()

    def add(self, value: Any) -> None:
        """Add a value; the keys of mappings are sorted."""
        if isinstance(value, dict):
            for key in sorted(value):
                self._sha.update(str(key).encode())
                self.add(value[key])
        elif isinstance(value, tuple | list):
            for item in value:
                self.add(item)
        else:
            self._sha.update(np.ascontiguousarray(value).tobytes())

    def __str__(self) -> str:
        """Return the first 16 hexadecimal digits."""
        return self._sha.hexdigest()[:16]


def digest(values: Any) -> str:
    """Return the checksum of one value."""
    total = Digest()
    total.add(values)
    return str(total)


def episode(env: gymnasium.Env[Any, Any], steps: int = 60) -> str:
    """Return the checksum of observations and rewards under random actions."""
    total = Digest()
    total.add(env.reset(seed=7)[0])
    env.action_space.seed(3)  # after the reset: highway-env replaces its action space there
    for _ in range(steps):
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        total.add([observation, reward])
        if terminated or truncated:
            total.add(env.reset()[0])
            env.action_space.seed(4)
    env.close()
    return str(total)


def vector_episode(env: Any, steps: int = 30) -> str:
    """Return the checksum of a vector environment's observations and rewards under random actions."""
    total = Digest()
    env.action_space.seed(3)
    total.add(env.reset(seed=7)[0])
    for _ in range(steps):
        observation, reward, *_ = env.step(env.action_space.sample())
        total.add([observation, reward])
    env.close()
    return str(total)


def stable_baselines() -> str:
    """Return the checksum of the first observations in the form of Stable-Baselines3."""
    envs = SonarVecEnv(8, sonar="srf08-mlp")
    envs.seed(7)
    return digest(envs.reset())


def draws(name: str) -> str:
    """Return the checksum of 2,000 readings of a model, their credence and their probabilities."""
    rng = np.random.default_rng(5)
    ping = Ping.of(
        distance=rng.uniform(0.1, 6.0, 2000),
        angle=rng.uniform(-0.9, 0.9, 2000),
        reflectance=rng.uniform(0.1, 0.9, 2000),
    )
    law = noise.load_model(name).law(ping)
    reading = law.sample(np.random.default_rng(6))
    parts = [reading.range, reading.status]
    if name != "rig":  # which only draws
        parts += [law.credence(), law.log_prob(reading)]
    return digest(parts)


def effects() -> Iterator[tuple[str, Callable[[], str]]]:
    """Yield the checksum of a physical model with each effect of the catalogue, at values inside its bounds."""
    for name, kind in noise.CATALOGUE.items():
        bounds = {p.name: p.low + 0.3 * (p.high - p.low) for p in kind.parameters}

        def one(kind: Any = kind, values: dict[str, float] = bounds) -> str:
            rng = np.random.default_rng(5)
            ping = Ping.of(distance=rng.uniform(0.1, 4.0, 200), angle=0.2, reflectance=0.6)
            law = noise.PhysicalModel([kind(**values)]).law(ping)
            return digest([law.credence(), law.sample(np.random.default_rng(6)).range])

        yield f"effect {name}", one


def driven(driver: Any) -> str:
    """Return the checksum of an episode of a driver with the learned sonar."""
    done = sonar_gym.run_episode(gymnasium.make("SonarParking-v0", sonar="srf08-mlp"), driver, seed=11)
    return digest([done.readings, done.echoes, done.credence, done.truths, done.score, done.success])


def sessions_split(folder: Path) -> None:
    """Write the rig's recording again as one of twenty sessions, which a law with memory needs."""
    rows = pd.read_csv(folder / "rig.csv")
    rows["session"] = np.arange(len(rows)) * 20 // len(rows)
    rows.to_csv(folder / "runs.csv", index=False)


def commands(folder: Path) -> Iterator[tuple[str, Callable[[], str]]]:
    """Yield the checksums of what short runs of the commands write."""

    def run(*words: str) -> None:
        done = subprocess.run([*COMMAND, *words], cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"sonar-gym {' '.join(words)}: exit {done.returncode}: {done.stderr[-2000:]}")

    def file(name: str) -> str:
        return hashlib.sha256((folder / name).read_bytes()).hexdigest()[:16]

    def made(name: str, *words: str) -> Callable[[], str]:
        def make() -> str:
            run(*words)
            return file(name)

        return make

    def learned(law: str) -> Callable[[], str]:
        words = ("train-noise", "rig.csv" if law == "mlp" else "runs.csv", "--law", law, "--epochs", "3")
        return made(f"{law}/weights.safetensors", *words, "--out", law)

    survey = ("--plan", "quick", "--pings", "2", "--seed", "1")
    yield "record rig", made("rig.csv", "record", "--out", "rig.csv", "--unit", "7", *survey)
    yield "record twin", made("twin.csv", "record", "--driver", "twin", "--out", "twin.csv", *survey)
    yield "train-noise mlp", learned("mlp")
    yield "train-noise lstm", lambda: sessions_split(folder) or learned("lstm")()
    few = ("--num-envs", "16", "--lessons", "20", "--sonars", "ideal", "srf08-mlp")
    yield "train-agent", made("agent/agent/weights.safetensors", "train-agent", "--out", "agent", *few)
    yield "diagnose", made("found/corrected/model.json", "diagnose", "rig.csv", "--out", "found")


def cases(folder: Path) -> Iterator[tuple[str, Callable[[], str]]]:
    """Yield every case with its name, in the order in which they are run."""
    gymnasium.register_envs(highway_env)
    for name in MODELS:
        yield f"draws {name}", lambda name=name: draws(name)
    yield from effects()
    for name in MODELS:
        if name == "rig":
            continue
        yield f"single {name}", lambda name=name: episode(gymnasium.make("SonarParking-v0", sonar=name))
        yield (
            f"vector {name}",
            lambda name=name: vector_episode(gymnasium.make_vec("SonarParking-v0", num_envs=9, sonar=name)),
        )
    for odometry, difficulty in (("wheels", "easy"), ("worn", "hard")):
        options = {"odometry": odometry, "difficulty": difficulty, "sonar": "srf08-lstm"}
        yield (
            f"single {odometry} {difficulty}",
            lambda options=options: episode(gymnasium.make("SonarParking-v0", **options)),
        )
    yield "sb3", stable_baselines
    for env_id in ("parking-v0", "highway-v0", "roundabout-v0"):
        yield (
            f"wrapped {env_id}",
            lambda env_id=env_id: episode(
                sonar_gym.SonarObservation(gymnasium.make(env_id), "srf08-mlp", latency_s=0.065), 15
            ),
        )
    yield (
        "wrapped parking",
        lambda: episode(sonar_gym.SonarObservation(gymnasium.make("SonarParking-v0"), "srf08-lstm", latency_s=0.065)),
    )
    yield "agent", lambda: driven(load_agent("parking"))
    yield "scripted driver", lambda: driven(sonar_gym.ParkingDriver())
    yield from commands(folder)


def main() -> int:
    """Print all checksums as JSON; with `--against`, print what differs and return 1 if anything does."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", type=Path, help="checksums to compare with")
    parser.add_argument("--only", default="", help="run the cases whose name begins with this")
    options = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, case in cases(Path(folder)):
            if not name.startswith(options.only):
                continue
            found[name] = case()
            print(f"{found[name]}  {name}", file=sys.stderr)
    if options.against is None:
        print(json.dumps(found, indent=1))
        return 0
    expected = json.loads(options.against.read_text())
    expected = {name: value for name, value in expected.items() if name.startswith(options.only)}
    differing = [name for name in expected | found if expected.get(name) != found.get(name)]
    print("\n".join(f"differs: {name}" for name in differing) or f"all {len(found)} checksums agree")
    return bool(differing)


if __name__ == "__main__":
    sys.exit(main())
