"""Make SonarParking-v0 with a noisy sonar and compare its readings with the true distances."""

import gymnasium

import sonar_gym  # noqa: F401 - registers the environment


def main() -> None:
    env = gymnasium.make("SonarParking-v0", sonar="gaussian")
    observation, info = env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(5):
        observation, reward, _, _, info = env.step(env.action_space.sample())
        reading, true = 3.01 * observation["ranges"][0], info["distance"][0]
        credence = observation["credence"][0]
        print(f"front: read {reading:.3f} m, true {true:.3f} m, credence {credence:.2f}; reward {reward:+.3f}")
    env.close()


if __name__ == "__main__":
    main()
