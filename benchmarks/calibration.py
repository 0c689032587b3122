"""Calibration of the credence given a reading, for each sonar, model and kind of driver.

    python -m benchmarks.calibration

Cars drive on streets that no table of credence was counted on. Of all echoes, the credence that was observed is
compared with the share of right readings: within 10 % of the distance of the face that answered, or would have if the
echo is that of another sonar's burst. Prints Markdown for
docs/explanation/realism.md and writes docs/images/calibration.png.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import numpy as np

from acquisition.arrays import Floats
from noise.law import CREDENCE_TOLERANCE
from sonar_gym.parking.prior import DRIVERS, driver_of
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.sensing.paths import DISTANCE, OBSTACLE
from sonar_gym.sensing.records import RANGE
from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, panels

MODELS = ("gaussian", "srf08-mlp", "srf08-lstm", "srf08-hybrid")
SEED = 6_000_000  # of streets used nowhere else
# Cars and observations of each: 30,720 readings of each sonar or more. A car that is driven at random leaves its start
# slowly, so more streets and whole episodes are needed
COURSES = {"agent": (256, 240), "scripted": (128, 240), "random": (512, 400)}
BINS = 10  # of credence, equally wide


def outcomes(model: str, driver: str) -> Floats:
    """Return readings, their total credence and the right ones, by sonar and bin of credence, (3, s, BINS)."""
    cars, steps = COURSES[driver]
    envs = SonarParkingVectorEnv(cars, model, credence_driver=driver, threads=1)
    act, begun = driver_of(driver)(cars), np.ones(cars, dtype=np.bool_)
    observation, shown = envs.reset(seed=SEED)[0], envs.fleet.sensing.pings
    sonar = np.broadcast_to(np.arange(len(envs.fleet.mounts)), shown.cause.shape)
    total = np.zeros((3, sonar.shape[1], BINS))
    for _ in range(steps):
        echo, credence = observation["echo"] == 1, observation["credence"].astype(np.float64)
        where = sonar[echo], np.minimum((BINS * credence[echo]).astype(np.int64), BINS - 1)
        ping = shown.of_shown(slice(None))[echo]
        near = np.abs(ping[:, RANGE] - ping[:, DISTANCE]) <= CREDENCE_TOLERANCE * ping[:, DISTANCE]
        for sums, weight in zip(total, (1.0, credence[echo], near & (ping[:, OBSTACLE] >= 0.0)), strict=True):
            np.add.at(sums, where, weight)
        observation = envs.step(act(observation, np.flatnonzero(begun)))[0]
        begun = envs.fleet.worlds.steps == 0
    envs.close()
    return total


def calibration_error(total: Floats) -> Floats:
    """Return the expected calibration error of each sonar, (s,): the mean gap between credence and share of right ones.

    Source: Naeini, Cooper and Hauskrecht 2015.
    """
    number, credence, right = total
    gap: Floats = np.abs(credence - right).sum(axis=1) / np.maximum(number.sum(axis=1), 1.0)
    return gap


def table(results: dict[tuple[str, str], Floats]) -> str:
    """Return the expected calibration errors as Markdown."""
    names = [mount.name for mount in LAYOUTS["eight"]]
    lines = ["| model | driver | fewest echoes | " + " | ".join(names) + " |", "|---|---|---|" + "---|" * len(names)]
    for (model, driver), total in results.items():
        errors = " | ".join(f"{error:.3f}" for error in calibration_error(total))
        lines.append(f"| {model} | {driver} | {int(total[0].sum(axis=1).min()):,} | {errors} |")
    return "\n".join(lines)


def _diagram(results: dict[tuple[str, str], Floats], driver: str, axes: Axes) -> None:
    axes.plot([0.0, 1.0], [0.0, 1.0], color=INK, linewidth=1.0)
    chosen = {model: total.sum(axis=1) for (model, kind), total in results.items() if kind == driver}
    for colour, (model, (number, credence, right)) in zip((SOFT, AFTER, BEFORE, INK), chosen.items(), strict=False):
        some = number >= 200
        axes.plot(credence[some] / number[some], right[some] / number[some], "o-", color=colour, label=model)
    axes.set_title(f"driver: {driver}")
    axes.set_xlabel("credence")
    axes.set_ylabel("share of right readings")
    axes.legend()


def main() -> None:
    """Measure, print the table and write the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, default=Path("docs/images/calibration.png"))
    parser.add_argument("--models", nargs="*", default=MODELS)
    parser.add_argument("--drivers", nargs="*", default=list(DRIVERS))
    options = parser.parse_args()
    results = {(model, driver): outcomes(model, driver) for driver in options.drivers for model in options.models}
    print(table(results))
    diagrams = [partial(_diagram, results, driver) for driver in options.drivers]
    options.figure.write_bytes(panels(diagrams, (4.4 * len(diagrams), 4.0), share_y=True))


if __name__ == "__main__":
    main()
