"""Add sonars to your own environment: here a trolley in a corridor, with two ranges in its observation."""

from typing import Any

import gymnasium
import numpy as np

from sonar_gym import SonarObservation


class Corridor(gymnasium.Env[np.ndarray, np.ndarray]):
    """A trolley between two walls 4 m apart; it observes its distance to both, in cm, and its speed."""

    def __init__(self) -> None:
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = gymnasium.spaces.Box(np.float32([0, 0, -1]), np.float32([400, 400, 1]))

    def _observe(self) -> np.ndarray:
        return np.array([400.0 - 100.0 * self.place, 100.0 * self.place, self.speed], dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Place the trolley at random."""
        super().reset(seed=seed)
        self.place, self.speed = float(self.np_random.uniform(0.5, 3.5)), 0.0
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Move for 0.1 s; the reward is greatest in the middle."""
        self.speed = float(np.clip(action[0], -1.0, 1.0))
        self.place = float(np.clip(self.place + 0.1 * self.speed, 0.05, 3.95))
        return self._observe(), -abs(self.place - 2.0), False, False, {}


def main() -> None:
    env = SonarObservation(Corridor(), "gaussian", indices=[0, 1], metres_per_unit=0.01, max_range=6.0, incidence=0.0)
    observation, info = env.reset(seed=0)
    print(env.observation_space)
    for _ in range(5):
        observation, _, _, _, info = env.step(np.array([0.5], dtype=np.float32))
        reading, true = 6.0 * observation["ranges"], info["sonar"]["distance"]
        print("read", reading, "m; true", true, "m; speed", observation["rest"])
    env.close()


if __name__ == "__main__":
    main()
