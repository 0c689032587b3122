"""Make the shipped noise models: record the corpus on the rig, train the networks, write models and cards."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from annotated_types import MinLen

from acquisition import Recording
from acquisition.io.places import OutputFolder
from acquisition.limits import Seed, Workers
from noise.learned.gain import LOSS
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.learned.networks import MlpModel
from noise.learned.persistence import survey_persistence
from noise.model import MAX_RANGE
from noise.store import load_model, save_model
from training.common.progress import bar
from training.noise import make_front_ends
from training.noise.baselines import score
from training.noise.card import card, scores_as_numbers
from training.noise.conditions import CONDITIONS, NEW_SENSORS, calibration, recordings
from training.noise.corpus import RECORDINGS, ensure_recorded, first_pings
from training.noise.train import Args as TrainArgs
from training.noise.train import Law, Report, TrainingPings, learn, no_report, run_segments

INPUTS = ("distance", "angle", "incidence", "reflectance", "temperature_c", LOSS)
HORIZON_M, STEP_M, COMPONENTS, FIXED = 6.5, 0.01, 6, 2
PINGS_PER_VISIT = 2  # for the perceptron: further pings of a visit depend on the same placement and add little
TRAINING_SETTINGS: dict[Law, dict[str, Any]] = {
    "mlp": {"epochs": 40, "patience": 40, "batch": 1024},
    "lstm": {"epochs": 50, "patience": 50, "batch": 32 * 32},
    "hybrid": {"epochs": 80, "patience": 25, "batch": 24 * 32},
}
N_VALIDATION_SENSORS: dict[Law, int] = {"mlp": 48, "lstm": 16, "hybrid": 16}
BASE_SETTINGS: dict[str, Any] = {"epochs": 60, "patience": 60, "batch": 512}  # of the hybrid's perceptron
NOTE = (
    "Simulated by the waveform rig, not measured: SRF08s of 160 serial numbers at their power-up gain, in {gains} of "
    "the sessions at lower gains, in the laboratory of Esmi (2016) at 14 to 26 degC: its plate and disc on their "
    "stand, parallel to the sensor's face or turned, at rest or moving; walls; no reflector, or one beyond the range "
    "gate. {more}The best weights were chosen on {n_sensors} other sensors; the scores are those of 80 further ones."
)
FAULTY_NOTE = "A twelfth of the sessions have a loose wire, a sensor that warms up, or both. "


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym make-noise`."""

    out: OutputFolder = Path("weights")
    """Folder to write the models to, one subfolder each."""
    data: OutputFolder = Path("corpus")
    """Folder of the recordings; missing ones are recorded."""
    sensors: Annotated[tuple[Literal["srf08", "hcsr04", "maxbotix"], ...], MinLen(1)] = ("srf08", "hcsr04", "maxbotix")
    """Kinds of sensors to make laws of."""
    laws: Annotated[tuple[Law, ...], MinLen(1)] = ("mlp", "lstm", "hybrid")
    """Laws of the SRF08 to make; other sensors have a perceptron."""
    jobs: Workers = 1
    """Number of parallel processes that record."""
    seed: Seed = 0
    """Seed of the initial weights and the order of pings."""
    cards_only: bool = False
    """Measure the models of the SRF08 in `out` again and write their cards, without training."""


def main(args: Args) -> None:
    """Record, train, score and write."""
    if "srf08" in args.sensors:
        _make_srf08(args)
    for sensor in args.sensors:
        if sensor != "srf08" and not args.cards_only:
            settings = TrainArgs(args.data, args.out / f"{sensor}-mlp", seed=args.seed, **make_front_ends.SETTINGS)
            with bar(f"training {sensor}-mlp", settings.epochs) as progress:
                report = partial(_report_epoch, progress, settings.epochs)
                print(f"{make_front_ends.make(sensor, settings, args.data, report, args.jobs)}: written")


def _make_srf08(args: Args) -> None:
    for name in RECORDINGS:
        with bar(f"recording {name}", 1) as progress:
            ensure_recorded(args.data, name, args.jobs, progress)
    conditions = recordings(CONDITIONS, NEW_SENSORS)
    for law in args.laws:
        settings = settings_of(law, args)
        if args.cards_only:
            train, _ = load_data(args.data, law, N_VALIDATION_SENSORS[law])
            print(f"{describe(load_model(settings.out), settings, train, args.data, conditions)}: card written")
            continue
        with bar(f"training srf08-{law}", settings.epochs) as progress:
            folder = make(settings, args.data, conditions, partial(_report_epoch, progress, settings.epochs))
        print(f"{folder}: written")


def _report_epoch(progress: Callable[[int, int], None], epochs: int, epoch: int, score: float) -> None:
    progress(epoch, epochs)


def settings_of(law: Law, args: Args) -> TrainArgs:
    """Return the training settings of a law."""
    return TrainArgs(args.data, args.out / f"srf08-{law}", law=law, seed=args.seed, **TRAINING_SETTINGS[law])


def make(settings: TrainArgs, data: Path, conditions: Mapping[str, Recording], report: Report = no_report) -> Path:
    """Train one law on the recordings in a folder, score it on new sensors, and write it."""
    n_sensors = N_VALIDATION_SENSORS[settings.law]
    with TemporaryDirectory() as folder:
        base = Path(folder) / "base"
        if settings.law == "hybrid":
            base_settings = replace(settings, law="mlp", **BASE_SETTINGS)
            save_model(_train(base_settings, load_data(data, "mlp", n_sensors)), base)
        train, validation = load_data(data, settings.law, n_sensors)
        model = _train(replace(settings, base=str(base)), (train, validation), report)
    if isinstance(model, MlpModel):  # laws with memory learn what persists
        model.persistence = survey_persistence(model, train.ping, train.reading)
    return describe(model, settings, train, data, conditions)


def describe(
    model: Any, settings: TrainArgs, train: Recording, data: Path, conditions: Mapping[str, Recording]
) -> Path:
    """Score a model on new sensors and under each condition, and write it with its card."""
    scores = score(model, train, Recording.load(data / "sensors.csv"))
    calibrated = {name: calibration(model, recording) for name, recording in conditions.items()}
    commands = ["sonar-gym make-noise"]
    model.about |= {"commands": commands, "seed": settings.seed, "scores": scores_as_numbers(scores)}
    model.about["calibration"] = {name: round(c.gap.mean, 4) for name, c in calibrated.items()}
    n_sensors = N_VALIDATION_SENSORS[settings.law]
    more, gains = ("", "two sevenths") if settings.law == "mlp" else (FAULTY_NOTE, "a sixth")
    note = NOTE.format(more=more, gains=gains, n_sensors=n_sensors)
    model.card = card(settings.out.name, model, scores, "conditions of new sensors", train, commands, note, calibrated)
    return save_model(model, settings.out)


def _train(settings: TrainArgs, parts: tuple[Recording, Recording], report: Report = no_report) -> Any:
    train, validation = parts
    inputs, head = (
        Inputs.of(train.ping, INPUTS, HORIZON_M, uncompensated=True),
        Head(COMPONENTS, FIXED, STEP_M, MAX_RANGE),
    )
    return learn(pings(train, settings.law), pings(validation, settings.law), inputs, head, settings, report)


def load_data(data: Path, law: Law, n_sensors: int) -> tuple[Recording, Recording]:
    """Return training and validation data of a law; more drives and sessions with faults are for recurrent laws only.

    Args:
        data: folder of the recordings.
        law: type of the network.
        n_sensors: number of validation sensors.
    """
    faulty, drives = ([], []) if law == "mlp" else (["faulty"], ["drives"])
    choose = _load_joined(data, ["validation", "gains-validation", *(f"{name}-validation" for name in faulty)])
    sensor = choose.table["sensor"].astype(int)
    chosen = choose.select((sensor < sensor.min() + n_sensors).to_numpy())
    return _load_joined(data, ["train", "gains", *faulty, *drives]), chosen


def _load_joined(data: Path, names: list[str]) -> Recording:
    recordings = [Recording.load(data / f"{name}.csv") for name in names]
    tables = [r.table.assign(session=f"{k}-" + r.table["session"].astype(str)) for k, r in enumerate(recordings)]
    return Recording(pd.concat(tables, ignore_index=True), " and ".join(f"{name}.csv" for name in names))


def pings(recording: Recording, law: Law) -> TrainingPings:
    """Return the training data of a law in a recording."""
    rows = first_pings(recording, PINGS_PER_VISIT) if law == "mlp" else np.ones(len(recording), dtype=bool)
    return TrainingPings.of(recording, rows, run_segments(recording)[0])
