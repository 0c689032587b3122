"""Train a noise model on a recording and score it on test data."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import torch
import tyro
from numpy.typing import NDArray
from rich.console import Console

from acquisition import Ping, Reading, Recording, SettingError
from acquisition.io.places import Output
from acquisition.limits import Count, Limit, PositiveMetres, Rate, Seed, Share
from noise import load_model
from noise.discrepancy.inputs import warnings_of
from noise.fitting.threads import one_thread
from noise.fitting.visits import visits_of
from noise.learned.inputs import Inputs
from noise.learned.mixture import END_EXCESS, Head
from noise.learned.networks import MlpModel
from noise.learned.recurrent import LstmModel
from noise.metrics import Evaluation, evaluate
from noise.model import MAX_RANGE, IdealModel, SonarModel, steps
from noise.store import ModelName, check_model_folder, save_model
from training.common.checksum import sha256
from training.common.progress import bars
from training.noise.baselines import fit_gaussian
from training.noise.card import card, score_table, scores_as_numbers
from training.noise.networks import (
    MAX_RUN_PINGS,
    LstmNetwork,
    MixtureNetwork,
    Schedule,
    TrainingBatch,
    fit_network,
    recurrent_head,
)

MIN_GROUPS = 10
Law = Literal["mlp", "lstm", "hybrid"]
Report = Callable[[int, float], None]


def no_report(epoch: int, score: float) -> None:
    """Ignore the report."""


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym train-noise`."""

    recording: Annotated[Path, tyro.conf.Positional]
    """Training data: CSV file with one row per ping."""
    out: Annotated[Path, Output("folder", "model.json")]
    """Folder to write the model to: model.json, weights.safetensors, README.md."""
    law: Law = "mlp"
    """mlp: no memory. lstm: memory of the pings of a run. hybrid: an LSTM that corrects the perceptron `base`."""
    base: ModelName = "srf08-mlp"
    """hybrid: perceptron to correct, by name or folder; its weights are fixed."""
    start: ModelName | None = None
    """mlp: perceptron with whose weights training begins, such as hcsr04-mlp for a recording of your HC-SR04; its
    inputs and widths are used, at a quarter of the learning rate."""
    hidden: Annotated[int, Limit(1, 4096)] = 64
    """Width of each hidden layer."""
    depth: Annotated[int, Limit(1, 32)] = 2
    """mlp: number of hidden layers."""
    state: Annotated[int, Limit(1, 4096)] = 48
    """lstm, hybrid: width of the state."""
    components: Annotated[int, Limit(1, 256)] = 6
    """Number of mixture components centred near the true distance."""
    fixed: Annotated[int, Limit(0, 256)] = 2
    """Number of mixture components anywhere on the scale, for clutter and ghosts."""
    covariates: tuple[str, ...] = ()
    """Logged columns used as inputs besides the geometry, for example temperature_c; if one is missing in use, the law
    is the average over its training values."""
    horizon: PositiveMetres | None = None
    """Distance beyond which there are no echoes, m: all farther pings share one law, that of an empty cone."""
    epochs: Count = 300
    """Largest number of passes over the training pings."""
    patience: Count = 40
    """Number of passes without a better validation score after which training stops."""
    batch: Count = 512
    """Pings per step."""
    learning_rate: Rate = 4e-3
    """Initial learning rate of AdamW, annealed to a hundredth along a cosine."""
    weight_decay: Share = 1e-3
    """Weight decay of AdamW."""
    validation: Share = 0.15
    """Fraction of conditions (runs for recurrent laws) on which the best weights are chosen."""
    test: Share = 0.2
    """Fraction of conditions (runs for recurrent laws) used for the reported scores."""
    seed: Seed = 0
    """Seed of the split, the initial weights and the order of pings."""
    made_by: tuple[str, ...] = ()
    """Commands that made the recording, for the model card."""
    note: str = ""
    """Remark on the data for the model card: which sensor, what was in front of it, where."""

    @property
    def schedule(self) -> Schedule:
        """Settings of the optimisation; a run of a recurrent law counts as 32 pings."""
        batch = self.batch if self.law == "mlp" else max(1, self.batch // 32)
        rate = self.learning_rate if self.start is None else self.learning_rate / 4.0
        return Schedule(self.epochs, self.patience, batch, rate, self.weight_decay)


@dataclass(frozen=True)
class DataSplit:
    """Masks of training, validation and test rows, in whole groups, (n,) bool."""

    train: NDArray[np.bool_]
    validation: NDArray[np.bool_]
    test: NDArray[np.bool_]

    @classmethod
    def by_group(
        cls,
        group: NDArray[np.int64],
        validation: float,
        test: float,
        rng: np.random.Generator,
        what: str = "groups",
        min_groups: int = MIN_GROUPS,
    ) -> DataSplit:
        """Assign whole groups at random.

        Raises:
            SettingError: too few groups, or fractions that leave none to train on.
        """
        names, segment = np.unique(group, return_inverse=True)
        groups = len(names)
        if groups < min_groups:
            raise SettingError(f"the recording holds {groups} {what}, training needs {min_groups}: record more")
        if not (0 < validation < 1 and 0 < test < 1 and validation + test < 0.9):
            raise SettingError(f"validation {validation:g} and test {test:g} must be > 0 and together < 0.9")
        n_test, n_validation = max(1, round(test * groups)), max(1, round(validation * groups))
        part = np.full(groups, 2)
        order = rng.permutation(groups)
        part[order[:n_test]], part[order[n_test : n_test + n_validation]] = 0, 1
        return cls(part[segment] == 2, part[segment] == 1, part[segment] == 0)


@dataclass(frozen=True)
class Trained:
    """Trained model, scores of the model and the baselines on the test data, and the unit of the split."""

    model: MlpModel | LstmModel
    scores: dict[str, Evaluation]
    unit: str


@dataclass(frozen=True)
class Rows:
    """What the rows of a recording are used for.

    Attributes:
        group: group of each row, which is not split, (n,).
        unit: name of the groups.
        split: masks of training, validation and test rows.
        beyond: which pings lie outside the ranges of the start, where its inputs cannot tell one from another, (n,).
    """

    group: NDArray[np.int64]
    unit: str
    split: DataSplit
    beyond: NDArray[np.bool_]

    @classmethod
    def of(cls, recording: Recording, args: Args) -> Rows:
        """Split a recording."""
        group, unit = groups(recording) if args.law == "mlp" else run_segments(recording)
        rng, start = np.random.default_rng(args.seed), start_of(args)
        split, beyond = DataSplit.by_group(group, args.validation, args.test, rng, unit), np.zeros(len(group), bool)
        if start is not None:
            beyond = start.inputs.features(start.inputs.equivalent(recording.ping)).excess > END_EXCESS
        return cls(group, unit, split, beyond)


def train(recording: Recording, args: Args, report: Report = no_report, rows: Rows | None = None) -> Trained:
    """Train a network on part of a recording and score it on the rest.

    Args:
        recording: the data.
        args: settings.
        report: called after each epoch with its number and the validation score.
        rows: what the rows are used for, where that is known.

    Raises:
        SettingError: too few conditions or runs, no echo at all, or a covariate that was not logged in every row.
    """
    rows = rows or Rows.of(recording, args)
    split, known = rows.split, ~rows.beyond
    masks = {"train": split.train & known, "validation": split.validation & known, "test": split.test}
    if args.law == "mlp":
        masks = {name: mask & recording.reading.answered for name, mask in masks.items()}
    if not (recording.reading.echo & masks["train"]).any() or not all(mask.any() for mask in masks.values()):
        where = "" if args.start is None else f" in the ranges of {args.start}"
        raise SettingError(
            f"{recording.name}: too few echoes or answers{where} to train, validate and test on: record more"
        )
    parts = {name: TrainingPings.of(recording, mask, rows.group) for name, mask in masks.items()}
    head, inputs = shape_of(recording, args, split.train & known)
    model = learn(parts["train"], parts["validation"], inputs, head, args, report)
    model.about["data"] = marks_of(recording, split)
    answered = ~split.test & recording.reading.answered
    baselines: dict[str, SonarModel] = {
        "ideal": IdealModel(head.resolution, head.max_range),
        "Gaussian, fitted": fit_gaussian(
            recording.ping[answered], recording.reading[answered], head.resolution, head.max_range
        ),
    }
    test = parts["test"]
    every: dict[str, SonarModel] = {**baselines, "network": model}
    scores = {name: evaluate(m, test.ping, test.reading, test.ping.run, answered=True) for name, m in every.items()}
    return Trained(model, scores, rows.unit)


def marks_of(recording: Recording, split: DataSplit) -> dict[str, str]:
    """Return checksums of a recording and of its test rows, by which a model that was trained on it is known."""
    rows = pd.util.hash_pandas_object(recording.table).to_numpy()
    return {"recording": sha256(rows.tobytes()), "test": sha256(split.test.tobytes())}


@dataclass(frozen=True)
class TrainingPings:
    """Pings and readings to train on, (n,); `run` of the pings bounds the memory of a recurrent law."""

    ping: Ping
    reading: Reading

    @classmethod
    def of(cls, recording: Recording, rows: NDArray[np.bool_], run: NDArray[np.int64]) -> TrainingPings:
        """Take some rows of a recording; `run` is of all rows."""
        return cls(replace(recording.ping[rows], run=run[rows]), recording.reading[rows])

    def batch(self, network: MixtureNetwork | LstmNetwork) -> TrainingBatch:
        """Return the tensors of a network, in runs if it is recurrent."""
        batch = TrainingBatch.of(network.inputs, network.head, self.ping, self.reading)
        return batch.in_runs(self.ping.run) if isinstance(network, LstmNetwork) else batch


def learn(
    train: TrainingPings, validation: TrainingPings, inputs: Inputs, head: Head, args: Args, report: Report = no_report
) -> Any:
    """Train a network, choose the best weights on validation data, and return the model."""
    with torch.random.fork_rng(), one_thread():
        torch.manual_seed(args.seed)
        network = _network(inputs, head, args)
        epoch, score = fit_network(network, train.batch(network), validation.batch(network), args.schedule, report)
    return network.to_model({"epoch": epoch, "validation_log_likelihood": score})


def _network(inputs: Inputs, head: Head, args: Args) -> MixtureNetwork | LstmNetwork:
    if args.law == "mlp":
        return MixtureNetwork(inputs, head, args.hidden, args.depth, start_of(args))
    if args.law == "lstm":
        return LstmNetwork(inputs, recurrent_head(head), args.state, args.hidden)
    base = load_model(args.base)
    if not isinstance(base, MlpModel) or abs(base.resolution - head.resolution) > 1e-9:
        raise SettingError(
            f"base {args.base!r}: expected a perceptron with register steps of {1e3 * head.resolution:g} mm; "
            "train one with `sonar-gym train-noise`"
        )
    return LstmNetwork(base.inputs, recurrent_head(base.head), args.state, args.hidden, base)


def start_of(args: Args) -> MlpModel | None:
    """Return the perceptron with which training begins, or None.

    Raises:
        SettingError: it is no perceptron, or the law to train is none.
    """
    if args.start is None:
        return None
    start = load_model(args.start)
    if args.law != "mlp" or not isinstance(start, MlpModel):
        raise SettingError(f"start {args.start!r}: expected a perceptron, for --law mlp; hcsr04-mlp is one")
    return start


def shape_of(recording: Recording, args: Args, rows: NDArray[np.bool_] | slice = slice(None)) -> tuple[Head, Inputs]:
    """Return head and inputs of the network: of rows of the recording, or of the start with the recording's register.

    What the recording has and the start does not know, or knows at another value only, is averaged over.
    """
    ping, head, start = recording.ping[rows], head_of(recording, args, rows), start_of(args)
    if start is None:
        return head, Inputs.of(ping, input_names(recording, args), args.horizon)
    reach = max(head.max_range, start.head.max_range)
    own = replace(start.head, resolution=head.resolution, max_range=reach, no_answer=head.no_answer)
    logged, known = ping.covariates, start.inputs
    fixed = {k: v for k, v in known.fixed.items() if k not in logged or np.allclose(logged[k], v)}
    new = (logged.keys() - known.known) | (known.fixed.keys() - fixed.keys())
    return own, replace(known, fixed=fixed, averaged=(*known.averaged, *sorted(new)))


def doubts(recording: Recording, args: Args, rows: Rows) -> list[str]:
    """Return sentences on pings that the start cannot tell apart, and on test rows that it or the base has seen."""
    found, beyond = list[str](), int(rows.beyond.sum())
    name = args.base if args.law == "hybrid" else args.start
    if name is None:
        return found
    model: Any = load_model(name)
    if beyond:
        limits = zip(model.inputs.names, model.inputs.low, model.inputs.high, strict=True)
        ranges = ", ".join(f"{quantity} {low:.4g} to {high:.4g}" for quantity, low, high in limits)
        found.append(f"{beyond} pings lie outside the ranges of {name} ({ranges}) and are not trained on")
    seen, own = getattr(model, "about", {}).get("data", {}), marks_of(recording, rows.split)
    if seen.get("recording") == own["recording"] and seen["test"] != own["test"]:
        found.append(f"{name} was trained on test rows of this recording, so the scores are too good: record others")
    return found


def groups(recording: Recording) -> tuple[NDArray[np.int64], str]:
    """Return the groups of the split, (n,), and their name: conditions, or visits if no condition recurs."""
    if np.bincount(recording.condition).mean() < 2.0:
        return visits_of(recording)[0], "visits"
    return recording.condition, "conditions"


def run_segments(recording: Recording) -> tuple[NDArray[np.int64], str]:
    """Return runs cut into segments of at most `MAX_RUN_PINGS` pings, (n,), and their name."""
    segment = np.empty(len(recording), dtype=np.int64)
    for k, rows in enumerate(steps(recording.run)):
        segment[rows] = k // MAX_RUN_PINGS
    cut = np.unique(np.stack([recording.run, segment]), axis=1, return_inverse=True)[1].ravel()
    return cut, "segments of runs"


def input_names(recording: Recording, args: Args) -> tuple[str, ...]:
    """Return the names of the network's inputs.

    Raises:
        SettingError: a covariate is not logged in every row.
    """
    missing = [name for name in args.covariates if name not in recording.ping.covariates]
    if missing:
        known = ", ".join(recording.ping.covariates) or "none"
        raise SettingError(f"{recording.name}: covariate {missing[0]!r} is not logged in every row; there are: {known}")
    reflectance = ["reflectance"] if recording.has("reflectance") else []
    return ("distance", "angle", "incidence", *reflectance, *args.covariates)


def head_of(recording: Recording, args: Args, rows: NDArray[np.bool_] | slice = slice(None)) -> Head:
    """Return a head whose register fits the recording, with the reach and the lost answers of some of its rows."""
    reading = recording.reading[rows]
    reach = max(MAX_RANGE, math.ceil(reading.range.max() + recording.resolution))
    return Head(args.components, args.fixed, recording.resolution, reach, float(1.0 - reading.answered.mean()))


def command(args: Args) -> str:
    """Return the equivalent command line of settings."""
    words = ["sonar-gym", "train-noise", args.recording.name, "--out", args.out.name]
    for f in fields(args):
        value = getattr(args, f.name)
        if f.name not in ("recording", "out", "made_by", "note") and (value != f.default or f.name == "seed"):
            words += [f"--{f.name.replace('_', '-')}", *map(str, value if isinstance(value, tuple) else [value])]
    return shlex.join(words)


def main(args: Args) -> None:
    """Print doubts about the data, train, print the scores, write the model and its card."""
    check_model_folder(args.out)
    recording, console = Recording.load(args.recording), Console()
    for warning in warnings_of(recording):
        print(f"warning: {warning}")
    rows = Rows.of(recording, args)
    for doubt in doubts(recording, args, rows):
        print(f"warning: {doubt}")
    with bars() as progress:
        task = progress.add_task("training", total=args.epochs)
        trained = train(
            recording,
            args,
            lambda epoch, score: progress.update(task, completed=epoch, description=f"validation {score:.3f} nats"),
            rows,
        )
    model, commands = trained.model, [*args.made_by, command(args)]
    model.about |= {"commands": commands, "seed": args.seed, "scores": scores_as_numbers(trained.scores)}
    model.card = card(args.out.name, model, trained.scores, trained.unit, recording, commands, args.note)
    save_model(model, args.out)
    console.print(score_table(trained.scores, trained.unit))
    print(f"{args.out}: best after {model.about['epoch']} passes; load it with noise.load_model({str(args.out)!r})")
