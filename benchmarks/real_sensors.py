"""Shipped laws of HC-SR04 and MaxBotix on recordings of real ones, against laws fitted to the same rows.

    SONAR_GYM_RECORDINGS=folder python -m benchmarks.real_sensors

The recordings are not part of the project. Each is divided by session, or by visit where there is one session; every
law is fitted to some parts and scored on the others. A shipped law is adapted as `sonar-gym train-noise --start` does.
Prints Markdown for docs/explanation/real-sensors.md.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import theilslopes

from acquisition import Ping, Reading, Recording
from acquisition.arrays import Floats, Ints
from noise import load_model
from noise.beam import fit_beam
from noise.law import CREDENCE_TOLERANCE, EchoLaw
from noise.metrics import ClusterMean, crps_with_silence
from noise.model import MAX_RANGE, SonarModel
from noise.store import WEIGHTS, save_model
from training.common.tables import markdown_table
from training.diagnosis.judging.real import READERS
from training.noise.baselines import PHYSICS_START, fit_gaussian, fit_physics
from training.noise.train import Args, DataSplit, TrainingPings, groups, learn, shape_of
from training.proof.real import FOLDER

GAUSSIAN, BEAM, PHYSICS = "Gaussian", "beam model", "physics"
FITTED = (GAUSSIAN, BEAM, PHYSICS)
SHIPPED, ADAPTED, SCRATCH = "{}-mlp", "{}-mlp, adapted", "perceptron without a start"
FOLDS, VALIDATION, SEED = 5, 0.2, 0
MAX_LINE_ROWS = 1500  # of the line through the readings, whose cost grows with the square
HCSR04_SILENCE_M, MAXBOTIX_SILENCE_M = 5.17, 5.0  # pulse of 30 ms, as the driver; largest value of an HRLV
PHYSICS_EFFECTS: Mapping[str, Mapping[str, float]] = {**PHYSICS_START, "clock_scale": {"error": 0.0}}

HEADING, LICENCE = "## On recordings of real sensors", "## Licence"
EXPLAINED = (
    "CRPS of held-out readings, mm, with silence; the other laws are fitted to the rows to which this one is adapted.\n"
    "`python -m benchmarks.real_sensors`; the recordings are not part of the project."
)


@dataclass(frozen=True)
class Case:
    """A real recording with true distances.

    Attributes:
        name: for the table.
        sensor: kind of sensor, of which a perceptron is shipped.
        folder: of the recording.
        read: returns its table with a column `part`, the unit of the split.
        silence_m: range from which a reading is no echo, m.
        step_mm: to which readings are rounded, mm.
    """

    name: str
    sensor: str
    folder: str
    read: Callable[[Path], pd.DataFrame]
    silence_m: float
    step_mm: float = 1.0

    def recording(self, root: Path) -> tuple[Recording, Ints]:
        """Return the recording, with silence, and the part of each row, (n,)."""
        table = self.read(root / self.folder).reset_index(drop=True)
        heard = (table.reading_mm > 0.0) & (table.reading_mm < 1e3 * self.silence_m - 0.5)
        steps = np.maximum(np.rint(table.reading_mm / self.step_mm), 1.0)
        table["reading_mm"] = np.where(heard, self.step_mm * steps, 0.0)
        part = pd.factorize(table.pop("part"))[0].astype(np.int64)
        return Recording(table, self.name), part


def _wall(sonar: str) -> Callable[[Path], pd.DataFrame]:
    def read(folder: Path) -> pd.DataFrame:
        parts = []
        for name in ("calibration", "training2"):
            log = pd.read_csv(folder / f"{name}.csv")
            reading = {"distance_mm": 1e3 * log["range"], "angle_deg": 0.0, "reading_mm": 1e3 * log[sonar]}
            parts.append(pd.DataFrame({**reading, "time_s": log.time, "session": name, "part": name}))
        return pd.concat(parts)

    return read


def _calibration(folder: Path) -> pd.DataFrame:
    table = READERS["calibration"][1](folder).drop(columns="interval_ms")
    return table.assign(part=table.session)


def _ten(folder: Path) -> pd.DataFrame:
    table = READERS["ten distances"][1](folder)
    return table.assign(part=table.session)


def _angles(folder: Path) -> pd.DataFrame:
    table = READERS["angles"][1](folder)
    return table.assign(part=table.distance_mm)


CASES = (
    Case("marks, HC-SR04", "hcsr04", "hcsr04-calibration", _calibration, HCSR04_SILENCE_M),
    Case("wall, HC-SR04", "hcsr04", "hcsr04-maxbotix-wall", _wall("sonar1"), HCSR04_SILENCE_M),
    Case("ten distances, HC-SR04", "hcsr04", "hcsr04-ten-distances", _ten, HCSR04_SILENCE_M, 10.0),
    Case("turned card, HC-SR04", "hcsr04", "hcsr04-angle", _angles, HCSR04_SILENCE_M, 10.0),
    Case("wall, MaxBotix", "maxbotix", "hcsr04-maxbotix-wall", _wall("sonar2"), MAXBOTIX_SILENCE_M),
)


def adapted(recording: Recording, start: str | None) -> SonarModel:
    """Return a perceptron trained on a recording, from a start or from nothing, as `train-noise` does."""
    args = Args(Path("rows.csv"), Path("out"), start=start, seed=SEED)
    head, inputs = shape_of(recording, args)
    group = groups(recording)[0]
    split = DataSplit.by_group(group, VALIDATION / 2.0, VALIDATION / 2.0, np.random.default_rng(SEED), min_groups=4)
    chosen = split.validation | split.test  # both choose the best weights; the scores are of other rows
    train, validation = (TrainingPings.of(recording, rows, group) for rows in (split.train, chosen))
    model: SonarModel = learn(train, validation, inputs, head, args)
    return model


@dataclass(frozen=True)
class Calibrated:
    """A law of readings about a line through them, instead of about the true distance.

    Attributes:
        model: fitted to the pings at the distances on the line.
        offset, slope: of the line, m and 1.
    """

    model: SonarModel
    offset: float
    slope: float
    remembers: bool = False

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the law of n pings."""
        law = self.model.law(self.on_line(ping, self.offset, self.slope))
        law.distance = ping.distance
        return law

    @staticmethod
    def on_line(ping: Ping, offset: float, slope: float) -> Ping:
        """Return the pings at the distances that the line gives."""
        return replace(ping, distance=np.maximum(offset + slope * ping.distance, 0.0))

    @classmethod
    def of(cls, recording: Recording, fitted: Callable[[Ping], SonarModel]) -> Calibrated:
        """Fit the line by Theil and Sen, which outliers do not move, then a law about it."""
        rows = np.flatnonzero(recording.reading.echo)
        rows = rows[:: max(1, len(rows) // MAX_LINE_ROWS)]
        slope, offset = theilslopes(recording.reading.range[rows], recording.ping.distance[rows])[:2]
        return cls(fitted(cls.on_line(recording.ping, offset, slope)), float(offset), float(slope))


def laws(recording: Recording, sensor: str) -> dict[str, SonarModel]:
    """Return all laws fitted to a recording, and the shipped one as it is."""
    step, ping, reading = recording.resolution, recording.ping, recording.reading
    start = SHIPPED.format(sensor)
    shipped: Any = load_model(start)
    shipped.head = replace(shipped.head, resolution=step)
    return {
        GAUSSIAN: fit_gaussian(ping, reading, step, MAX_RANGE),
        BEAM: fit_beam(ping, reading, step, MAX_RANGE)[0],
        f"{GAUSSIAN}, calibrated": Calibrated.of(recording, lambda on: fit_gaussian(on, reading, step, MAX_RANGE)),
        f"{BEAM}, calibrated": Calibrated.of(recording, lambda on: fit_beam(on, reading, step, MAX_RANGE)[0]),
        PHYSICS: fit_physics(recording, MAX_RANGE, PHYSICS_EFFECTS, pings=len(recording)),
        start: shipped,
        ADAPTED.format(sensor): adapted(recording, start),
        SCRATCH: adapted(recording, None),
    }


def scores(case: Case, root: Path) -> tuple[dict[str, Floats], Ints]:
    """Return the scores of held-out rows by law, (3, n), and their parts, (n,).

    They are the CRPS with silence, mm; the Brier score of an echo; and that of a reading within 10 % of the distance.
    """
    recording, part = case.recording(root)
    parts = int(part.max()) + 1
    fold = np.random.default_rng(SEED).permutation(parts)[part] % min(FOLDS, parts)
    out: dict[str, Floats] = {}
    for k in range(int(fold.max()) + 1):
        held = fold == k
        test = recording.select(held)
        ping, reading = test.ping, test.reading
        right = reading.echo & (np.abs(reading.range - ping.distance) <= CREDENCE_TOLERANCE * ping.distance + 1e-9)
        for name, model in laws(recording.select(~held), case.sensor).items():
            law = model.law(ping)
            crps = 1e3 * crps_with_silence(law, reading, case.silence_m)
            rows = [crps, (law.echo - reading.echo) ** 2, (law.credence() - right) ** 2]
            out.setdefault(name, np.empty((3, len(part))))[:, held] = rows
    return out, part


def table(found: dict[str, Floats], part: Ints) -> str:
    """Return the means by law, with the difference of the CRPS from that of the best fitted law."""
    best = min(FITTED, key=lambda name: found[name][0].mean())
    rows = []
    for name, (crps, echo, right) in found.items():
        apart = "best of three" if name == best else str(ClusterMean.of(crps - found[best][0], part))
        rows.append((name, f"{crps.mean():.1f}", apart, f"{echo.mean():.4f}", f"{right.mean():.4f}"))
    header = ("law", "CRPS with silence, mm", "less the best fitted, mm", "Brier, echo", "Brier, within 10 %")
    return markdown_table(header, rows)


def verdict(crps: Mapping[str, float], law: str) -> str:
    """Return how the CRPS of a law compares with those of the fitted laws, in words."""
    worse = [name for name in FITTED if crps[name] < crps[law]]
    return f"**worse than {', '.join(worse)}**" if worse else "better than all three"


def section(sensor: str, means: Mapping[str, Mapping[str, float]]) -> str:
    """Return the section of a card on the recordings of a kind of sensor.

    Args:
        sensor: kind of sensor.
        means: CRPS with silence, mm, by law, by recording.
    """
    laws_of = SHIPPED.format(sensor), ADAPTED.format(sensor)
    rows = []
    for name, crps in means.items():
        own = [f"{crps[law]:.1f}, {verdict(crps, law)}" for law in laws_of]
        rows.append((name, *(f"{crps[law]:.1f}" for law in FITTED), *own))
    header = ("recording", *FITTED, "this law as it is", "adapted with `train-noise --start`")
    return f"{HEADING}\n\n{EXPLAINED}\n\n{markdown_table(header, rows)}\n\n"


def write_card(sensor: str, means: Mapping[str, Mapping[str, float]]) -> None:
    """Put the scores of a shipped law on real recordings into its description and its card."""
    folder = WEIGHTS / SHIPPED.format(sensor)
    model: Any = load_model(str(folder))
    before, licence = model.card.split(LICENCE)
    model.about["real"] = means
    model.card = before.partition(HEADING)[0] + section(sensor, means) + LICENCE + licence
    save_model(model, folder)


def main() -> None:
    """Score all cases, print the tables and write the cards."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cards", action="store_true", help="write the scores into the cards of the shipped laws")
    args = parser.parse_args()
    root, means = Path(os.environ[FOLDER]), dict[str, dict[str, dict[str, float]]]()
    for case in CASES:
        found, part = scores(case, root)
        crps = {name: round(float(value[0].mean()), 2) for name, value in found.items()}
        means.setdefault(case.sensor, {})[case.name] = crps
        title = f"## {case.name}\n\n{len(part)} readings in {part.max() + 1} parts."
        print(f"\n{title}\n\n{table(found, part)}", flush=True)
    if args.cards:
        for sensor, own in means.items():
            write_card(sensor, own)


if __name__ == "__main__":
    main()
