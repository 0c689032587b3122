"""Make the shipped noise models again: record what they learn from on the rig, train the three, write them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from acquisition import Recording
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.metrics import Evaluation, evaluate
from noise.model import MAX_RANGE, IdealModel, SonarModel
from noise.store import save_model
from training.common.progress import bar
from training.noise.card import card, plain
from training.noise.corpus import RECORDINGS, thinned, written
from training.noise.train import Args as TrainArgs
from training.noise.train import Law, Pings, Report, fit_gaussian, learn, silent, stretches

TOLD = ("distance", "angle", "incidence", "reflectance", "temperature_c")
HORIZON_M, STEP_M, COMPONENTS, FIXED = 6.5, 0.01, 6, 2
PINGS_A_VISIT = 2  # that the perceptron learns from: more of one tell where that reflector stood, not how sonars are
PLANS: dict[Law, dict[str, Any]] = {
    "mlp": {"epochs": 40, "patience": 40, "batch": 1024},
    "lstm": {"epochs": 50, "patience": 50, "batch": 32 * 32},
    "hybrid": {"epochs": 80, "patience": 25, "batch": 24 * 32},
}
CHOSEN_BY: dict[Law, int] = {"mlp": 48, "lstm": 16, "hybrid": 16}  # sensors by which the best weights are chosen
BASE: dict[str, Any] = {
    "epochs": 60,
    "patience": 60,
    "batch": 512,
}  # of the perceptron under the hybrid
NOTE = (
    "Simulated by the waveform rig, not measured: SRF08s of 160 serial numbers at their power-up gain, in the "
    "laboratory of Esmi (2016) at 14 to 26 degC: its plate and disc on their stand, parallel to the sensor's "
    "face or turned away from it, coming and going; walls; nothing at all, or too far away. {more}The best weights "
    "were chosen by {choosing} other sensors; the scores are those of 80 more."
)
FAULTY = "A sixth of the sessions have a loose wire, a sensor that is warming up, or both. "


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym make-noise`."""

    out: Path = Path("weights")
    """Folder to write the models to, a folder each."""
    data: Path = Path("corpus")
    """Folder for what they learn from; recordings that are there already are not made again."""
    laws: tuple[Law, ...] = ("mlp", "lstm", "hybrid")
    """Which to make."""
    jobs: int = 1
    """Processes that record at a time."""
    seed: int = 0
    """Decides the first weights and the order of pings."""


def main(args: Args) -> None:
    """Record, train, score and write."""
    for name in RECORDINGS:
        with bar(f"recording {name}", 1) as progress:
            written(args.data, name, args.jobs, progress)
    for law in args.laws:
        plan = plan_of(law, args)
        with bar(f"training srf08-{law}", plan.epochs) as progress:
            folder = make(plan, args.data, partial(_passed, progress, plan.epochs))
        print(f"{folder}: written")


def _passed(progress: Callable[[int, int], None], epochs: int, epoch: int, score: float) -> None:
    progress(epoch, epochs)


def plan_of(law: Law, args: Args) -> TrainArgs:
    """Return how a law is trained."""
    return TrainArgs(args.data, args.out / f"srf08-{law}", law=law, seed=args.seed, **PLANS[law])


def make(plan: TrainArgs, data: Path, report: Report = silent) -> Path:
    """Train one law on the recordings in a folder, score it on sensors that it has not met, and write it."""
    with TemporaryDirectory() as folder:
        base = Path(folder) / "base"
        if plan.law == "hybrid":
            under = replace(plan, law="mlp", **BASE)
            save_model(_learned(under, material(data, "mlp", CHOSEN_BY[plan.law])), base)
        train, validation = material(data, plan.law, CHOSEN_BY[plan.law])
        model = _learned(replace(plan, base=str(base)), (train, validation), report)
    scores = scored(model, train, Recording.load(data / "units.csv"))
    commands = ["sonar-gym make-noise"]
    model.about |= {"commands": commands, "seed": plan.seed, "scores": plain(scores)}
    note = NOTE.format(more="" if plan.law == "mlp" else FAULTY, choosing=CHOSEN_BY[plan.law])
    model.card = card(plan.out.name, model, scores, "conditions of held-out sensors", train, commands, note)
    return save_model(model, plan.out)


def _learned(plan: TrainArgs, parts: tuple[Recording, Recording], report: Report = silent) -> Any:
    train, validation = parts
    inputs, head = Inputs.of(train.ping, TOLD, HORIZON_M), Head(COMPONENTS, FIXED, STEP_M, MAX_RANGE)
    return learn(pings(train, plan.law), pings(validation, plan.law), inputs, head, plan, report)


def material(data: Path, law: Law, choosing: int) -> tuple[Recording, Recording]:
    """Return what a law learns from, and what chooses its weights; sessions with faults are for laws that remember.

    Args:
        data: folder of the recordings.
        law: that learns.
        choosing: number of sensors by which the weights are chosen.
    """
    also = [] if law == "mlp" else ["faulty"]
    choose = _joined(data, ["validation", *(f"{name}-validation" for name in also)])
    sensor = choose.table["sensor"].astype(int)
    return _joined(data, ["train", *also]), choose.select((sensor < sensor.min() + choosing).to_numpy())


def _joined(data: Path, names: list[str]) -> Recording:
    recordings = [Recording.load(data / f"{name}.csv") for name in names]
    tables = [r.table.assign(session=f"{k}-" + r.table["session"].astype(str)) for k, r in enumerate(recordings)]
    return Recording(pd.concat(tables, ignore_index=True), " and ".join(f"{name}.csv" for name in names))


def pings(recording: Recording, law: Law) -> Pings:
    """Return what a law learns from a recording."""
    rows = thinned(recording, PINGS_A_VISIT) if law == "mlp" else np.ones(len(recording), dtype=bool)
    return Pings.of(recording, rows, stretches(recording)[0])


def scored(model: SonarModel, train: Recording, test: Recording) -> dict[str, Evaluation]:
    """Return the scores of a model and of what simulators have, on sensors that it has not met."""
    answered = train.reading.answered
    gaussian = fit_gaussian(train.ping[answered], train.reading[answered], model.resolution, MAX_RANGE)
    rivals: dict[str, SonarModel] = {"ideal": IdealModel(model.resolution, MAX_RANGE), "Gaussian, fitted": gaussian}
    place = np.unique(np.stack([test.run, test.condition]), axis=1, return_inverse=True)[1].ravel()
    return {k: evaluate(m, test.ping, test.reading, place) for k, m in {**rivals, "network": model}.items()}
