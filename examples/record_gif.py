"""Record an episode of the scripted controller as a GIF, or one image of it: python examples/record_gif.py a.gif."""

import os
import sys
from pathlib import Path

import gymnasium
import imageio.v3 as iio

from sonar_gym import ParkingDriver, run_episode


def main(path: str = "parking.gif", sonar: str = "gaussian", seed: int = 3, every: int = 2) -> None:
    env = gymnasium.make("SonarParking-v0", sonar=sonar, render_mode="rgb_array")
    episode = run_episode(env, ParkingDriver(), seed=seed, every=every)
    env.close()
    temporary = Path(path).with_suffix(f".part{Path(path).suffix}")
    if temporary.suffix == ".gif":
        iio.imwrite(temporary, episode.frames, duration=100 * every, loop=0)
    else:
        iio.imwrite(temporary, episode.frames[len(episode.frames) * 4 // 5])  # backing into the space
    os.replace(temporary, path)
    print(f"{path}: {len(episode.frames)} images, parked: {episode.success}")


if __name__ == "__main__":
    main(*sys.argv[1:3])
