"""Train DQN to follow the traffic of highway-env without a sonar, with an ideal and with a realistic one.

One lane at a scale of 1:10 and a car ahead, whose speed differs from episode to episode; one sonar on the nose. Without
it, a car can only drive as slowly as the slowest traffic. Prints return, speed and collisions in unseen traffic, and
draws the returns during training.
"""

from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import highway_env  # noqa: F401 - registers highway-fast-v0
import numpy as np
import torch
from gymnasium.wrappers import FilterObservation, FrameStackObservation
from stable_baselines3 import DQN
from stable_baselines3.common.monitor import Monitor

from acquisition.io.files import write_bytes
from sonar_gym import SonarObservation
from training.common.canvas import AFTER, BEFORE, SOFT, Axes, panels
from training.common.commit import commit
from training.common.records import write_record

ARMS = {"no sonar": None, "ideal sonar": "ideal", "srf08-mlp": "srf08-mlp"}
SLOWEST, FASTEST = 10.0, 25.0  # m/s, of the traffic
ROAD = {
    "lanes_count": 1,
    "vehicles_count": 1,
    "action": {"type": "DiscreteMetaAction", "lateral": False, "target_speeds": [10, 15, 20, 25]},
    "reward_speed_range": [SLOWEST, FASTEST],
}
UNSEEN = 1_000_000  # seed of the first traffic of the test
SMOOTHED, POINTS = 30, 200  # episodes of a mean of a curve; its points
Record = dict[str, list[Any]]  # curves of each arm


class Traffic(gymnasium.Wrapper):
    """Traffic of another speed in each episode; all cars start with the lowest speed."""

    def reset(self, **settings: Any) -> tuple[Any, dict[str, Any]]:
        """Draw the speed."""
        out, base = self.env.reset(**settings), self.unwrapped
        base.vehicle.speed, base.vehicle.target_speed = SLOWEST, SLOWEST
        for one in base.road.vehicles[1:]:
            one.speed = one.target_speed = base.np_random.uniform(SLOWEST, FASTEST)
        return out


class Result(NamedTuple):
    """Steps and return of each episode of training; return, mean speed and collision of each of the test."""

    steps: np.ndarray
    returns: np.ndarray
    tested: np.ndarray


def make(sonar: str | None) -> Monitor:
    """Return the road; a car observes its speed and, with a sonar, the readings, at the last two decisions."""
    nose = [{"name": "nose", "x": 2.5, "y": 0.0, "heading_deg": 0.0}]
    road = Traffic(gymnasium.make("highway-fast-v0", config=ROAD))
    env = SonarObservation(road, sonar or "ideal", sonar_layout=nose, metres_per_unit=0.1)
    shown = ["base"] if sonar is None else ["base", "ranges", "echo", "credence"]
    return Monitor(FrameStackObservation(FilterObservation(env, shown), 2))


def drive(model: DQN, env: Monitor, seed: int) -> tuple[float, float, bool]:
    """Return sum of rewards, mean speed in m/s, and whether the car collided, of one episode."""
    observation, _ = env.reset(seed=seed)
    score, speeds, over, info = 0.0, [], False, {}
    while not over:
        observation, reward, terminated, truncated, info = env.step(model.predict(observation, deterministic=True)[0])
        score, over = score + float(reward), terminated or truncated
        speeds.append(info["speed"])
    return score, float(np.mean(speeds)), bool(info["crashed"])


def train(sonar: str | None, steps: int, episodes: int, seed: int) -> Result:
    """Train one agent, and test it."""
    env = make(sonar)
    settings = {"learning_rate": 5e-4, "gamma": 0.9, "learning_starts": 200, "exploration_fraction": 0.5}
    model = DQN("MultiInputPolicy", env, seed=seed, device="cpu", target_update_interval=100, **settings)
    model.learn(steps)
    ends, returns = np.cumsum(env.get_episode_lengths()), np.array(env.get_episode_rewards())
    tested = [drive(model, env, UNSEEN + k) for k in range(episodes)]
    env.close()
    return Result(ends, returns, np.array(tested))


def record_of(results: dict[str, list[Result]]) -> Record:
    """Return decisions and mean return of the last episodes during training, of each agent."""
    return {arm: [smoothed(one) for one in each] for arm, each in results.items()}


def smoothed(one: Result) -> list[np.ndarray]:
    """Return decisions and mean returns at `POINTS` points of a training."""
    n = min(SMOOTHED, len(one.returns))
    means, ends = np.convolve(one.returns, np.full(n, 1.0 / n), mode="valid"), one.steps[n - 1 :]
    at = np.linspace(ends[0], ends[-1], POINTS)
    return [at, np.interp(at, ends, means)]


def figure(record: Record) -> bytes:
    """Draw the mean returns, as PNG."""

    def draw(axes: Axes) -> None:
        for colour, (arm, each) in zip((SOFT, BEFORE, AFTER), record.items(), strict=True):
            for k, (decisions, mean) in enumerate(each):
                axes.plot(decisions, mean, color=colour, label=None if k else arm)
        axes.set(xlabel="decisions", ylabel=f"return, mean of {SMOOTHED} episodes", ylim=(0.0, None))
        axes.legend(loc="lower right")

    return panels([draw], (6.4, 3.6))


def main(
    steps: int = 6000, seeds: int = 3, episodes: int = 30, path: str = "runs/highway.png"
) -> dict[str, list[Result]]:
    torch.set_num_threads(1)
    made_by, results = commit(), {}
    for arm, sonar in ARMS.items():
        results[arm] = [train(sonar, steps, episodes, seed) for seed in range(seeds)]
        score, speed, crashed = np.array([one.tested.mean(axis=0) for one in results[arm]]).T
        each = ", ".join(f"{one:.1f}" for one in score)
        print(f"{arm}: return {each}; {speed.mean():.1f} m/s; collided in {crashed.mean():.0%}", flush=True)
    record = write_record(Path(path), made_by, "python examples/train_highway.py", record_of(results))
    write_bytes(Path(path), figure(record))
    return results


if __name__ == "__main__":
    main()
