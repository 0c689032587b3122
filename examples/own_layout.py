"""Define a sonar layout: poses, cones, ping periods and latencies."""

import gymnasium
import numpy as np

import sonar_gym  # noqa: F401 - registers the environment
from sonar_gym.sensing.mounts import Mount

# A narrow sonar in front that pings every 0.1 s, and two wide sonars on the right that alternate.
LAYOUT = [
    Mount("nose", x=0.36, y=0.0, heading_deg=0.0, cone_deg=20.0),
    Mount("right front", x=0.26, y=-0.10, heading_deg=-90.0, period_s=0.2, phase_s=0.0, latency_s=0.025),
    Mount("right rear", x=0.0, y=-0.10, heading_deg=-90.0, period_s=0.2, phase_s=0.1, latency_s=0.025),
]


def main() -> None:
    env = gymnasium.make("SonarParking-v0", sonar="gaussian", sonar_layout=LAYOUT)
    observation, info = env.reset(seed=0)
    for _ in range(5):
        observation, _, _, _, info = env.step(np.array([0.0, 0.5], dtype=np.float32))
        for k, mount in enumerate(LAYOUT):
            reading, age = 3.01 * observation["ranges"][k], 1000 * observation["age"][k]
            print(f"{mount.name}: read {reading:.3f} m, {age:.0f} ms old, true {info['distance'][k]:.3f} m", end="; ")
        print()
    env.close()


if __name__ == "__main__":
    main()
