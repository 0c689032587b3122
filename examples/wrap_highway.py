"""Replace the lidar, or the list of other vehicles, of highway-env by eight sonars."""

import gymnasium
import highway_env  # noqa: F401 - registers its environments
import numpy as np

from sonar_gym import SonarObservation


def main() -> None:
    env = SonarObservation(gymnasium.make("parking-v0", config={"vehicles_count": 20}), "srf08-mlp", latency_s=0.065)
    observation, info = env.reset(seed=0)
    print(env.observation_space)
    detections = 0
    while detections < 8:
        observation, _, terminated, truncated, info = env.step(np.array([0.4, 0.1], dtype=np.float32))
        if terminated or truncated:
            observation, info = env.reset()
        if not info["sonar"]["in_cone"].any():
            continue
        detections += 1
        k = int(np.argmin(info["sonar"]["distance"]))
        reading, true = 6.0 * observation["ranges"][k], info["sonar"]["distance"][k]
        credence, age = observation["credence"][k], 1000 * observation["age"][k]
        name = env.source.mounts[k].name
        print(f"{name}: read {reading:.2f} m, {age:.0f} ms old, true {true:.2f} m, credence {credence:.2f}")
    road = SonarObservation(gymnasium.make("highway-v0", config={"vehicles_count": 10}), "gaussian")
    print("highway-v0:", {name: value.shape for name, value in road.reset(seed=0)[0].items()})
    env.close()
    road.close()


if __name__ == "__main__":
    main()
