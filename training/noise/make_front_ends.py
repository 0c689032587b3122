"""Make the shipped perceptrons of sensors with other front ends than the SRF08: HC-SR04 and MaxBotix."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from acquisition import Recording
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.learned.networks import MlpModel
from noise.learned.persistence import survey_persistence
from noise.metrics import Evaluation
from noise.model import MAX_RANGE
from noise.store import save_model
from training.common.progress import bar
from training.noise.baselines import score
from training.noise.card import card, scores_as_numbers
from training.noise.conditions import Calibration, calibration
from training.noise.corpus import Sessions, first_pings, record, record_session_file
from training.noise.train import Args as TrainArgs
from training.noise.train import Report, TrainingPings, groups, learn

Sensor = Literal["hcsr04", "maxbotix"]
GEOMETRY = ("distance", "angle", "incidence", "reflectance")
INPUTS: Mapping[Sensor, tuple[str, ...]] = {"hcsr04": (*GEOMETRY, "temperature_c"), "maxbotix": GEOMETRY}
HORIZON_M, STEP_M, COMPONENTS, FIXED, PINGS_PER_VISIT = 6.5, 0.001, 6, 2, 2
TEMPERATURE_C = (0.0, 40.0)
SETTINGS: dict[str, Any] = {"epochs": 40, "patience": 40, "batch": 1024}
# numbers of sensors to train on, to choose the weights on, and to score on; a filter takes pings before each visit
N_SENSORS: Mapping[Sensor, tuple[int, int, int]] = {"hcsr04": (160, 48, 80), "maxbotix": (80, 24, 40)}
NEW_SENSORS = Sessions(tuple(range(900, 924)), surveys=3, drives=1, visits=40, pings=30)
TEMPERATURES_C: Mapping[Sensor, tuple[float, ...]] = {
    "hcsr04": (-10.0, 0.0, 10.0, 20.0, 30.0, 40.0, 45.0),
    "maxbotix": (-10.0, 20.0, 45.0),  # it corrects the speed of sound itself
}
NAMES: Mapping[Sensor, str] = {"hcsr04": "HC-SR04", "maxbotix": "MaxBotix (XL, HRLV)"}
NOTE = (
    "Simulated by the waveform rig, not measured: sensors of the kind {name} with {train} serial numbers, whose "
    "electronics no data sheet states, in rooms of random size 0.1 to 1.5 m above the floor, at 0 to 40 degC: the "
    "plate and disc of Esmi (2016) on their stand, walls, and no reflector. The best weights were chosen on {choose} "
    "other sensors; the scores are those of {test} further ones."
)


def parts_of(sensor: Sensor) -> dict[str, Sessions]:
    """Return the sessions to record of a kind of sensor, by name."""
    train, choose, test = N_SENSORS[sensor]
    every = Sessions((), temperature_c=TEMPERATURE_C, sensor=sensor)
    return {
        "train": replace(every, units=tuple(range(1001, 1001 + train)), surveys=8, drives=2),
        "validation": replace(every, units=tuple(range(1201, 1201 + choose)), surveys=4, drives=1),
        "sensors": replace(every, units=tuple(range(201, 201 + test)), surveys=2, drives=0, seed=3),
    }


def recordings(sensor: Sensor, folder: Path, jobs: int = 1) -> dict[str, Recording]:
    """Return the recordings of a kind of sensor by name; missing ones are recorded into a folder."""
    out = {}
    for name, sessions in parts_of(sensor).items():
        with bar(f"recording {sensor} {name}", 1) as progress:
            path = record_session_file(folder / f"{sensor}-{name}.csv", sessions, jobs, progress)
        out[name] = Recording.load(path)
    return out


def conditions(sensor: Sensor) -> dict[str, Recording]:
    """Return recordings of new sensors by temperature."""
    each = {
        t: replace(NEW_SENSORS, sensor=sensor, seed=100 + k, temperature_c=(t, t))
        for k, t in enumerate(TEMPERATURES_C[sensor])
    }
    return {f"{t:g} degC": record(sessions) for t, sessions in each.items()}


def make(sensor: Sensor, settings: TrainArgs, folder: Path, report: Report, jobs: int = 1) -> Path:
    """Record, train, score and write the perceptron of a kind of sensor.

    Args:
        sensor: kind of sensor.
        settings: of the training; `out` is the model's folder.
        folder: of the recordings.
        report: called after each epoch.
        jobs: number of parallel processes that record.
    """
    parts = recordings(sensor, folder, jobs)
    inputs = Inputs.of(parts["train"].ping, INPUTS[sensor], HORIZON_M, uncompensated=sensor == "hcsr04")
    head = Head(COMPONENTS, FIXED, STEP_M, MAX_RANGE)
    model: MlpModel = learn(_pings(parts["train"]), _pings(parts["validation"]), inputs, head, settings, report)
    model.persistence = survey_persistence(model, parts["train"].ping, parts["train"].reading)
    scores = score(model, parts["train"], parts["sensors"])
    calibrated = {name: calibration(model, recording) for name, recording in conditions(sensor).items()}
    return _write(model, sensor, settings, parts["train"], scores, calibrated)


def _pings(recording: Recording) -> TrainingPings:
    return TrainingPings.of(recording, first_pings(recording, PINGS_PER_VISIT), groups(recording)[0])


def _write(
    model: MlpModel,
    sensor: Sensor,
    settings: TrainArgs,
    train: Recording,
    scores: dict[str, Evaluation],
    calibrated: Mapping[str, Calibration],
) -> Path:
    commands = [f"sonar-gym make-noise --sensors {sensor}"]
    model.about |= {"commands": commands, "seed": settings.seed, "scores": scores_as_numbers(scores)}
    model.about["calibration"] = {name: round(c.gap.mean, 4) for name, c in calibrated.items()}
    numbers = dict(zip(("train", "choose", "test"), N_SENSORS[sensor], strict=True))
    note = NOTE.format(name=NAMES[sensor], **numbers)
    unit = "conditions of new sensors"
    model.card = card(settings.out.name, model, scores, unit, train, commands, note, calibrated)
    return save_model(model, settings.out)
