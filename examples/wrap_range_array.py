"""Add sonars to a simulator with an array of ranges in its observation, such as MuJoCo's rangefinders.

The ranges are in metres along rays, and -1 for a ray that hits nothing. `dt` is the time between observations.
"""

from typing import Any

import gymnasium
import numpy as np

from sonar_gym import SonarObservation, SonarVectorObservation

RAYS = np.arange(8) * np.pi / 4
REACH = 4.0  # m


class Rover(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """A point with eight rangefinders in a round pit of 3 m radius that has a gap in its wall."""

    dt = 0.02

    def __init__(self) -> None:
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        sensors = gymnasium.spaces.Box(-1.0, REACH, (8,), np.float32)
        self.observation_space = gymnasium.spaces.Dict(
            {"qpos": gymnasium.spaces.Box(-3.0, 3.0, (2,), np.float32), "rangefinder": sensors}
        )

    def _observe(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the observation, and an info with the angle of incidence of each ray."""
        direction = np.column_stack([np.cos(RAYS), np.sin(RAYS)])
        along = direction @ self.place
        reach = -along + np.sqrt(along**2 + 9.0 - self.place @ self.place)
        hit = self.place + reach[:, None] * direction
        no_hit = (np.abs(np.arctan2(hit[:, 1], hit[:, 0])) < 0.3) | (reach > REACH)
        incidence = np.arccos(np.clip((hit * direction).sum(axis=1) / 3.0, -1.0, 1.0))
        ranges = np.where(no_hit, -1.0, reach).astype(np.float32)
        return {"qpos": self.place.astype(np.float32), "rangefinder": ranges}, {"incidence": incidence}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Place the point near the centre."""
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-1.0, 1.0, 2)
        return self._observe()

    def step(self, action: np.ndarray) -> Any:
        """Move for `dt`."""
        self.place = np.clip(self.place + self.dt * np.asarray(action), -2.0, 2.0)
        observation, info = self._observe()
        return observation, -float(np.hypot(*self.place)), False, False, info


SETTINGS: dict[str, Any] = {
    "key": "rangefinder",
    "empty": -1.0,  # value of the simulator for a ray that hits nothing
    "max_range": REACH,
    "incidence": "incidence",  # key of info
    "period_s": 0.08,  # two groups of four, which alternate
    "phase_s": [0.0, 0.04] * 4,
    "latency_s": 0.025,
}


def main() -> None:
    env = SonarObservation(Rover(), "srf08-mlp", **SETTINGS)
    observation, info = env.reset(seed=0)
    for _ in range(5):
        observation, _, _, _, info = env.step(np.array([0.5, 0.2], dtype=np.float32))
        reading, age = REACH * observation["ranges"][2:4], 1000 * observation["age"][2:4]
        print("read", reading.round(2), "m,", age.round(), "ms old; true", info["sonar"]["distance"][2:4].round(3), "m")
    many = gymnasium.vector.SyncVectorEnv([Rover] * 4)
    observations, _ = SonarVectorObservation(many, "srf08-mlp", **SETTINGS).reset(seed=0)
    print("four environments:", observations["ranges"].shape)


if __name__ == "__main__":
    main()
