"""Real sonars for a simulator whose observation holds an array of ranges, as MuJoCo's rangefinders give it.

They measure metres along a ray, and say -1 where they hit nothing. `dt` is the time between observations.
"""

from typing import Any

import gymnasium
import numpy as np

from sonar_gym import SonarObservation, SonarVectorObservation

RAYS = np.arange(8) * np.pi / 4
REACH = 4.0  # m


class Rover(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """A point that slides about in a round pit of 3 m radius with a gap in its wall, and looks eight ways."""

    dt = 0.02

    def __init__(self) -> None:
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        sensors = gymnasium.spaces.Box(-1.0, REACH, (8,), np.float32)
        self.observation_space = gymnasium.spaces.Dict(
            {"qpos": gymnasium.spaces.Box(-3.0, 3.0, (2,), np.float32), "rangefinder": sensors}
        )

    def _see(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the observation, and in info what MuJoCo knows of each hit: the angle to its normal."""
        way = np.column_stack([np.cos(RAYS), np.sin(RAYS)])
        along = way @ self.place
        reach = -along + np.sqrt(along**2 + 9.0 - self.place @ self.place)
        hit = self.place + reach[:, None] * way
        gone = (np.abs(np.arctan2(hit[:, 1], hit[:, 0])) < 0.3) | (reach > REACH)
        incidence = np.arccos(np.clip((hit * way).sum(axis=1) / 3.0, -1.0, 1.0))
        ranges = np.where(gone, -1.0, reach).astype(np.float32)
        return {"qpos": self.place.astype(np.float32), "rangefinder": ranges}, {"incidence": incidence}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Put the point somewhere near the middle."""
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-1.0, 1.0, 2)
        return self._see()

    def step(self, action: np.ndarray) -> Any:
        """Slide for `dt`."""
        self.place = np.clip(self.place + self.dt * np.asarray(action), -2.0, 2.0)
        observation, info = self._see()
        return observation, -float(np.hypot(*self.place)), False, False, info


HOW: dict[str, Any] = {
    "key": "rangefinder",
    "empty": -1.0,  # what the simulator says where a ray hits nothing
    "max_range": REACH,
    "incidence": "incidence",  # from info
    "period_s": 0.08,  # two groups of four, which take turns
    "phase_s": [0.0, 0.04] * 4,
    "latency_s": 0.025,
}


def main() -> None:
    env = SonarObservation(Rover(), "srf08-mlp", **HOW)
    observation, info = env.reset(seed=0)
    for _ in range(5):
        observation, _, _, _, info = env.step(np.array([0.5, 0.2], dtype=np.float32))
        said, age = REACH * observation["ranges"][2:4], 1000 * observation["age"][2:4]
        print("said", said.round(2), "m,", age.round(), "ms ago; true", info["sonar"]["distance"][2:4].round(3), "m")
    many = gymnasium.vector.SyncVectorEnv([Rover] * 4)
    observations, _ = SonarVectorObservation(many, "srf08-mlp", **HOW).reset(seed=0)
    print("four at once:", observations["ranges"].shape)


if __name__ == "__main__":
    main()
