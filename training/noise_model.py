"""Train a noise model on a recording and say, on conditions held out, what it is worth."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from rich.console import Console
from scipy.optimize import minimize

from acquisition import Ping, Reading, Recording, SettingError
from noise.cells import cells_of
from noise.metrics import Evaluation, evaluate
from noise.model import MAX_RANGE, GaussianModel, IdealModel, SonarModel
from noise.networks import Head, Inputs, MlpModel
from noise.store import check_model_folder, save_model
from training.model_card import card, plain, table
from training.networks import Batch, Network, Schedule, fit_network
from training.progress import bars
from training.threads import one_thread

FEWEST_CELLS = 10


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym train-noise`."""

    recording: Annotated[Path, tyro.conf.Positional]
    """CSV file to learn from, one row a ping."""
    out: Path
    """Folder to write the model to: model.json, weights.safetensors, README.md."""
    hidden: int = 64
    """Width of each hidden layer."""
    depth: int = 2
    """Number of hidden layers."""
    components: int = 6
    """Mixture components placed about the true distance."""
    fixed: int = 2
    """Mixture components placed anywhere on the scale: clutter, ghosts."""
    covariates: tuple[str, ...] = ()
    """Logged columns to learn from besides the geometry, for example temperature_c; to be given at every use."""
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
    """Share of cells by which the best weights are chosen."""
    test: float = 0.2
    """Share of cells held out for the scores that are reported."""
    seed: int = 0
    """Decides the split, the first weights and the order of pings."""
    made_by: tuple[str, ...] = ()
    """Commands that made the recording, for the card."""
    note: str = ""
    """On the data, for the card: which sensor, what was in front of it, where."""

    @property
    def schedule(self) -> Schedule:
        """How the network is trained."""
        return Schedule(self.epochs, self.patience, self.batch, self.learning_rate, self.weight_decay)


@dataclass(frozen=True)
class Split:
    """Which rows train, validate and test; whole cells each, (n,) bool."""

    train: NDArray[np.bool_]
    validation: NDArray[np.bool_]
    test: NDArray[np.bool_]

    @classmethod
    def by_cell(cls, cell: NDArray[np.int64], validation: float, test: float, rng: np.random.Generator) -> Split:
        """Deal whole cells out at random.

        Raises:
            SettingError: too few cells, or shares that leave none to train on.
        """
        names, place = np.unique(cell, return_inverse=True)
        cells = len(names)
        if cells < FEWEST_CELLS:
            raise SettingError(f"the recording holds {cells} conditions, training needs {FEWEST_CELLS}: record more")
        if not (0 < validation < 1 and 0 < test < 1 and validation + test < 0.9):
            raise SettingError(f"validation {validation:g} and test {test:g} must be > 0 and together < 0.9")
        n_test, n_validation = max(1, round(test * cells)), max(1, round(validation * cells))
        part = np.full(cells, 2)
        order = rng.permutation(cells)
        part[order[:n_test]], part[order[n_test : n_test + n_validation]] = 0, 1
        return cls(part[place] == 2, part[place] == 1, part[place] == 0)


def fit_gaussian(ping: Ping, reading: Reading, resolution: float, max_range: float) -> GaussianModel:
    """Return the most likely `GaussianModel` of answered pings: what is usually put in a simulator."""
    echo = reading.echo
    miss = float(np.clip(1.0 - echo.mean(), 0.0, 0.999))

    def model(x: NDArray[np.float64]) -> GaussianModel:
        sigma, per_metre = np.exp(np.clip(x, -20.0, 3.0))
        return GaussianModel(float(sigma), float(per_metre), miss, resolution, max_range)

    def loss(x: NDArray[np.float64]) -> float:
        return -float(np.maximum(model(x).law(ping[echo]).log_prob(reading[echo]), -1e3).mean())

    found = minimize(loss, np.log([0.03, 0.02]), method="Nelder-Mead", options={"xatol": 0.01, "fatol": 1e-4})
    return model(found.x)


@dataclass(frozen=True)
class Trained:
    """What training gave: the model, the scores of it and of its rivals on what was held out, and what that was."""

    model: MlpModel
    scores: dict[str, Evaluation]
    unit: str


def train(
    recording: Recording, args: Args, report: Callable[[int, float], None] = lambda epoch, score: None
) -> Trained:
    """Train a network on a recording.

    Args:
        recording: what to learn from.
        args: settings.
        report: called after each pass with its number and the validation score.

    Raises:
        SettingError: too few conditions, no echo at all, or a covariate that was not logged in every row.
    """
    ping, reading = recording.ping, recording.reading
    inputs, head = Inputs.of(ping, _logged(recording, args.covariates)), _head(recording, args)
    cell, unit = groups(recording)
    split = Split.by_cell(cell, args.validation, args.test, np.random.default_rng(args.seed))
    answered = reading.answered
    rows = {name: getattr(split, name) & answered for name in ("train", "validation", "test")}
    if not (reading.echo & split.train).any() or not all(mask.any() for mask in rows.values()):
        raise SettingError(f"{recording.name}: too few echoes or answers to train, validate and test on: record more")
    with torch.random.fork_rng(), one_thread():
        torch.manual_seed(args.seed)
        network = Network(inputs, head, args.hidden, args.depth)
        parts = {name: Batch.of(inputs, head, ping[mask], reading[mask]) for name, mask in rows.items()}
        epoch, validation = fit_network(network, parts["train"], parts["validation"], args.schedule, report)
    learn = rows["train"] | rows["validation"]
    rivals: dict[str, SonarModel] = {
        "ideal": IdealModel(head.resolution, head.max_range),
        "Gaussian, fitted": fit_gaussian(ping[learn], reading[learn], head.resolution, head.max_range),
    }
    model = network.to_model(inputs, {"epoch": epoch, "validation_log_likelihood": validation})
    t = rows["test"]
    scores = {k: evaluate(m, ping[t], reading[t], cell[t]) for k, m in {**rivals, "network": model}.items()}
    return Trained(model, scores, unit)


def groups(recording: Recording) -> tuple[NDArray[np.int64], str]:
    """Return what is held out whole, (n,), and its name: conditions, or stretches of pings where none was met twice."""
    if np.bincount(recording.cell).mean() < 2.0:
        return cells_of(recording)[0], "stretches of a run"
    return recording.cell, "conditions"


def _logged(recording: Recording, covariates: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of what the network is told: only what was logged."""
    missing = [name for name in covariates if name not in recording.ping.covariates]
    if missing:
        known = ", ".join(recording.ping.covariates) or "none"
        raise SettingError(f"{recording.name}: covariate {missing[0]!r} is not logged in every row; there are: {known}")
    return ("distance", "angle", "incidence", *(["reflectance"] if recording.has("reflectance") else []), *covariates)


def _head(recording: Recording, args: Args) -> Head:
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
