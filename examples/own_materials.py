"""Define the materials of the boxes, and compare how often a weak sonar detects foam, cardboard and steel."""

import gymnasium
import numpy as np

import sonar_gym  # noqa: F401 - registers the environment
from noise import CATALOGUE, PhysicalModel

MATERIALS = {
    "foam": {"reflectance": 0.05, "texture_deg": 0.0},
    "cardboard": {"reflectance": 0.6, "texture_deg": 3.0},
    "ribbed steel": {"reflectance": 0.9, "texture_deg": 15.0},
}
WEAK = PhysicalModel(
    [
        CATALOGUE["reflectance_loss"](strength=1.0),
        CATALOGUE["specular_loss"](strength=1.0),
        CATALOGUE["sensitivity"](loss_db=50.0),
    ]
)
RIGHT_FRONT = 3  # index of the sonar that points to the right


def passing(material: dict[str, float], seed: int) -> tuple[list[bool], list[float]]:
    """Drive past a box of a material; return whether each ping at it was detected, and the credence."""
    boxes = [{"begin": 0.3, "length": 1.2, **material}, {"begin": 2.4, "length": 0.4}]
    env = gymnasium.make("SonarParking-v0", sonar=WEAK)
    observation, info = env.reset(seed=seed, options={"boxes": boxes, "start": [0.2, 0.0, 0.0]})
    detected, credence = [], []
    for _ in range(20):
        observation, _, _, _, info = env.step(np.array([0.0, 0.8], dtype=np.float32))
        if info["in_cone"][RIGHT_FRONT] and info["distance"][RIGHT_FRONT] < 0.3:
            detected.append(bool(observation["echo"][RIGHT_FRONT] == 1.0))
            credence.append(float(observation["credence"][RIGHT_FRONT]))
    env.close()
    return detected, credence


def main() -> None:
    for name, material in MATERIALS.items():
        runs = [passing(material, seed) for seed in range(3)]
        detected, credence = (np.concatenate(part) for part in zip(*runs, strict=True))
        print(
            f"{name}: {100 * detected.mean():.0f} % of {len(detected)} pings detected, credence {credence.mean():.2f}"
        )


if __name__ == "__main__":
    main()
