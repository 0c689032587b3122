"""Train a noise model on a recording and say, on pings held out, what it is worth."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from rich.console import Console

from acquisition import Ping, Reading, Recording, SettingError
from noise import load_model
from noise.fitting.threads import one_thread
from noise.fitting.visits import visits_of
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.learned.networks import MlpModel
from noise.learned.recurrent import LstmModel
from noise.metrics import Evaluation, evaluate
from noise.model import MAX_RANGE, IdealModel, SonarModel, steps
from noise.store import check_model_folder, save_model
from training.common.progress import bars
from training.noise.baselines import fit_gaussian
from training.noise.card import card, plain, table
from training.noise.networks import LONGEST, Batch, Memory, Network, Schedule, fit_network, with_memory

FEWEST_GROUPS = 10
Law = Literal["mlp", "lstm", "hybrid"]
Report = Callable[[int, float], None]


def silent(epoch: int, score: float) -> None:
    """Report nothing."""


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym train-noise`."""

    recording: Annotated[Path, tyro.conf.Positional]
    """CSV file to learn from, one row a ping."""
    out: Path
    """Folder to write the model to: model.json, weights.safetensors, README.md."""
    law: Law = "mlp"
    """mlp: no memory. lstm: remembers the pings of a run. hybrid: an LSTM on top of the perceptron `base`."""
    base: str = "srf08-mlp"
    """hybrid: perceptron whose law is corrected, by name or folder; it learns no more."""
    hidden: int = 64
    """Width of each hidden layer."""
    depth: int = 2
    """mlp: number of hidden layers."""
    state: int = 48
    """lstm, hybrid: width of the state."""
    components: int = 6
    """Mixture components placed about the true distance."""
    fixed: int = 2
    """Mixture components placed anywhere on the scale: clutter, ghosts."""
    covariates: tuple[str, ...] = ()
    """Logged columns to learn from besides the geometry, for example temperature_c; where one is not given when the
    model is used, its law is that over all of the values learned."""
    horizon: float | None = None
    """Distance from which on nothing is heard, m: all farther pings teach one law, that of an empty cone."""
    epochs: int = 300
    """Most passes over the training pings."""
    patience: int = 40
    """Passes without a better validation score after which training stops."""
    batch: int = 512
    """Pings a step."""
    learning_rate: float = 4e-3
    """Of Adam, at its highest; it falls to a hundredth along a cosine."""
    weight_decay: float = 1e-3
    """Pull of all weights towards zero."""
    validation: float = 0.15
    """Share of cells, or of runs where the law remembers, by which the best weights are chosen."""
    test: float = 0.2
    """Share of cells, or of runs where the law remembers, held out for the scores that are reported."""
    seed: int = 0
    """Decides the split, the first weights and the order of pings."""
    made_by: tuple[str, ...] = ()
    """Commands that made the recording, for the card."""
    note: str = ""
    """On the data, for the card: which sensor, what was in front of it, where."""

    @property
    def schedule(self) -> Schedule:
        """How the network is trained; a run of a law that remembers stands for its pings."""
        batch = self.batch if self.law == "mlp" else max(1, self.batch // 32)
        return Schedule(self.epochs, self.patience, batch, self.learning_rate, self.weight_decay)


@dataclass(frozen=True)
class Split:
    """Which rows train, validate and test; whole groups each, (n,) bool."""

    train: NDArray[np.bool_]
    validation: NDArray[np.bool_]
    test: NDArray[np.bool_]

    @classmethod
    def by_group(
        cls, group: NDArray[np.int64], validation: float, test: float, rng: np.random.Generator, what: str = "groups"
    ) -> Split:
        """Deal whole groups out at random.

        Raises:
            SettingError: too few groups, or shares that leave none to train on.
        """
        names, place = np.unique(group, return_inverse=True)
        groups = len(names)
        if groups < FEWEST_GROUPS:
            raise SettingError(f"the recording holds {groups} {what}, training needs {FEWEST_GROUPS}: record more")
        if not (0 < validation < 1 and 0 < test < 1 and validation + test < 0.9):
            raise SettingError(f"validation {validation:g} and test {test:g} must be > 0 and together < 0.9")
        n_test, n_validation = max(1, round(test * groups)), max(1, round(validation * groups))
        part = np.full(groups, 2)
        order = rng.permutation(groups)
        part[order[:n_test]], part[order[n_test : n_test + n_validation]] = 0, 1
        return cls(part[place] == 2, part[place] == 1, part[place] == 0)


@dataclass(frozen=True)
class Trained:
    """What training gave: the model, the scores of it and of its rivals on what was held out, and what that was."""

    model: MlpModel | LstmModel
    scores: dict[str, Evaluation]
    unit: str


def train(recording: Recording, args: Args, report: Report = silent) -> Trained:
    """Train a network on some of a recording and score it on the rest.

    Args:
        recording: what to learn from.
        args: settings.
        report: called after each pass with its number and the validation score.

    Raises:
        SettingError: too few conditions or runs, no echo at all, or a covariate that was not logged in every row.
    """
    group, unit = groups(recording) if args.law == "mlp" else stretches(recording)
    split = Split.by_group(group, args.validation, args.test, np.random.default_rng(args.seed), unit)
    rows = {name: getattr(split, name) for name in ("train", "validation", "test")}
    if args.law == "mlp":
        rows = {name: mask & recording.reading.answered for name, mask in rows.items()}
    if not (recording.reading.echo & split.train).any() or not all(mask.any() for mask in rows.values()):
        raise SettingError(f"{recording.name}: too few echoes or answers to train, validate and test on: record more")
    parts = {name: Pings.of(recording, mask, group) for name, mask in rows.items()}
    head = head_of(recording, args)
    model = learn(parts["train"], parts["validation"], Inputs.of(recording.ping, told(recording, args), args.horizon),
                  head, args, report)  # fmt: skip
    seen = (rows["train"] | rows["validation"]) & recording.reading.answered
    rivals: dict[str, SonarModel] = {
        "ideal": IdealModel(head.resolution, head.max_range),
        "Gaussian, fitted": fit_gaussian(
            recording.ping[seen], recording.reading[seen], head.resolution, head.max_range
        ),
    }
    test = parts["test"]
    every: dict[str, SonarModel] = {**rivals, "network": model}
    scores = {
        name: evaluate(m, test.ping, test.reading, recording.condition[rows["test"]]) for name, m in every.items()
    }
    return Trained(model, scores, unit)


@dataclass(frozen=True)
class Pings:
    """Pings to learn from: conditions, with the run within which a law may remember, and readings, (n,)."""

    ping: Ping
    reading: Reading

    @classmethod
    def of(cls, recording: Recording, rows: NDArray[np.bool_], run: NDArray[np.int64]) -> Pings:
        """Take some rows of a recording; `run` is of all rows."""
        return cls(replace(recording.ping[rows], run=run[rows]), recording.reading[rows])

    def batch(self, network: Network | Memory) -> Batch:
        """Return them as a network learns them: in runs, where it remembers."""
        batch = Batch.of(network.inputs, network.head, self.ping, self.reading)
        return batch.in_runs(self.ping.run) if isinstance(network, Memory) else batch


def learn(train: Pings, validation: Pings, inputs: Inputs, head: Head, args: Args, report: Report = silent) -> Any:
    """Train a network on some pings, keeping the weights that are best on others; returns a model."""
    with torch.random.fork_rng(), one_thread():
        torch.manual_seed(args.seed)
        network = _network(inputs, head, args)
        epoch, score = fit_network(network, train.batch(network), validation.batch(network), args.schedule, report)
    return network.to_model({"epoch": epoch, "validation_log_likelihood": score})


def _network(inputs: Inputs, head: Head, args: Args) -> Network | Memory:
    if args.law == "mlp":
        return Network(inputs, head, args.hidden, args.depth)
    if args.law == "lstm":
        return Memory(inputs, with_memory(head), args.state, args.hidden)
    base = load_model(args.base)
    if not isinstance(base, MlpModel) or abs(base.resolution - head.resolution) > 1e-9:
        raise SettingError(
            f"base {args.base!r}: expected a perceptron that counts in steps of {1e3 * head.resolution:g} mm; "
            "train one with `sonar-gym train-noise`"
        )
    return Memory(base.inputs, with_memory(base.head), args.state, args.hidden, base)


def groups(recording: Recording) -> tuple[NDArray[np.int64], str]:
    """Return what is held out whole, (n,), and its name: conditions, or stretches of pings where none was met twice."""
    if np.bincount(recording.condition).mean() < 2.0:
        return visits_of(recording)[0], "stretches of a run"
    return recording.condition, "conditions"


def stretches(recording: Recording) -> tuple[NDArray[np.int64], str]:
    """Return runs cut into stretches of at most `LONGEST` pings, (n,), and their name."""
    place = np.empty(len(recording), dtype=np.int64)
    for k, rows in enumerate(steps(recording.run)):
        place[rows] = k // LONGEST
    cut = np.unique(np.stack([recording.run, place]), axis=1, return_inverse=True)[1].ravel()
    return cut, "stretches of runs"


def told(recording: Recording, args: Args) -> tuple[str, ...]:
    """Return the names of what the network is told: only what was logged.

    Raises:
        SettingError: a covariate was not.
    """
    missing = [name for name in args.covariates if name not in recording.ping.covariates]
    if missing:
        known = ", ".join(recording.ping.covariates) or "none"
        raise SettingError(f"{recording.name}: covariate {missing[0]!r} is not logged in every row; there are: {known}")
    reflectance = ["reflectance"] if recording.has("reflectance") else []
    return ("distance", "angle", "incidence", *reflectance, *args.covariates)


def head_of(recording: Recording, args: Args) -> Head:
    """Return a head whose register fits the recording."""
    reading = recording.reading
    reach = max(MAX_RANGE, math.ceil(reading.range.max() + recording.resolution))
    return Head(args.components, args.fixed, recording.resolution, reach, float(1.0 - reading.answered.mean()))


def command(args: Args) -> str:
    """Return the command line that these settings stand for."""
    words = ["sonar-gym", "train-noise", args.recording.name, "--out", args.out.name]
    for f in fields(args):
        value = getattr(args, f.name)
        if f.name not in ("recording", "out", "made_by", "note") and (value != f.default or f.name == "seed"):
            words += [f"--{f.name.replace('_', '-')}", *map(str, value if isinstance(value, tuple) else [value])]
    return shlex.join(words)


def main(args: Args) -> None:
    """Train, print the scores, write the model and its card."""
    check_model_folder(args.out)
    recording, console = Recording.load(args.recording), Console()
    with bars() as progress:
        task = progress.add_task("training", total=args.epochs)
        trained = train(
            recording,
            args,
            lambda epoch, score: progress.update(task, completed=epoch, description=f"validation {score:.3f} nats"),
        )
    model, commands = trained.model, [*args.made_by, command(args)]
    model.about |= {"commands": commands, "seed": args.seed, "scores": plain(trained.scores)}
    model.card = card(args.out.name, model, trained.scores, trained.unit, recording, commands, args.note)
    save_model(model, args.out)
    console.print(table(trained.scores, trained.unit))
    print(f"{args.out}: best after {model.about['epoch']} passes; load it with noise.load_model({str(args.out)!r})")
