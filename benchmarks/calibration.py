"""Calibration of the credence given a reading, for each sonar, model and kind of driver.

    python -m benchmarks.calibration

Cars drive on streets that no table of credence was counted on. Of all echoes, the credence that was observed is
compared with the share of right readings: within 10 % of the distance of the face that answered, or would have if the
echo is that of another sonar's burst. Prints Markdown for
docs/explanation/realism.md and writes docs/images/calibration.png with its
record.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import numpy as np

from acquisition.arrays import Floats
from acquisition.io.files import write_bytes
from noise.law import CREDENCE_TOLERANCE
from sonar_gym.parking.prior import DRIVERS, driver_of
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.sensing.paths import DISTANCE, OBSTACLE
from sonar_gym.sensing.records import RANGE
from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, panels
from training.common.commit import commit
from training.common.records import write_record

MODELS = ("gaussian", "srf08-mlp", "srf08-lstm", "srf08-hybrid")
SEED = 6_000_000  # of streets used nowhere else
# Cars and observations of each: 30,720 readings of each sonar or more. A car that is driven at random leaves its start
# slowly, so more streets and whole episodes are needed
COURSES = {"agent": (256, 240), "scripted": (128, 240), "random": (512, 400)}
BINS = 10  # of credence, equally wide
LEAST = 200  # readings of a bin that is drawn
COLOURS = (SOFT, AFTER, BEFORE, INK)
Record = dict[str, dict[str, list[list[float]]]]  # points by driver and model


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


def figure(record: Record) -> bytes:
    """Return a diagram for each driver, as PNG."""
    return panels([partial(_diagram, record, driver) for driver in record], (3.2 * len(record), 3.4), share_y=True)


def _diagram(record: Record, driver: str, axes: Axes) -> None:
    axes.plot([0.0, 1.0], [0.0, 1.0], color=SOFT, linewidth=1.0)
    for colour, (model, points) in zip(COLOURS, record[driver].items(), strict=False):
        axes.plot(*np.transpose(points), "o-", color=colour, markersize=4, label=model)
    axes.set(title=f"driver: {driver}", xlabel="credence")
    if driver == next(iter(record)):
        axes.set_ylabel("share of right readings")
        axes.legend()


def points(total: Floats) -> Floats:
    """Return mean credence and share of right readings of each bin with enough readings, (b, 2)."""
    number, credence, right = total.sum(axis=1)
    some = number >= LEAST
    return np.stack([credence[some], right[some]], axis=1) / number[some, None]


def main() -> None:
    """Measure, print the table, write the record and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, default=Path("docs/images/calibration.png"))
    parser.add_argument("--models", nargs="*", default=MODELS)
    parser.add_argument("--drivers", nargs="*", default=list(DRIVERS))
    options, made_by = parser.parse_args(), commit()
    results = {(model, driver): outcomes(model, driver) for driver in options.drivers for model in options.models}
    print(table(results))
    plain = {d: {model: points(results[model, d]) for model in options.models} for d in options.drivers}
    record = write_record(options.figure, made_by, "python -m benchmarks.calibration", plain)
    write_bytes(options.figure, figure(record))


if __name__ == "__main__":
    main()
