"""Comparison of optimisers: its networks, their training and storage, and tests of the thesis's claims."""

from __future__ import annotations

import hashlib
import json
import math
import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save
from scipy.stats import kendalltau, rankdata, spearmanr, t

from acquisition import ModelError
from acquisition.io.files import write_bytes
from training.common.commit import commit
from training.thesis.data import LSTM_TIME_RATIO, TABLES, Floats, OptimiserName, Samples
from training.thesis.fit import OPTIMISERS, Fitted, Recipe, fit
from training.thesis.networks import FlatNetwork
from training.thesis.surfaces import MIRROR, RUBBER, SHORT_RANGE_M, CredenceSurfaces

ARRAYS = ("theta", "train", "validation", "seconds")
FIGURE_UNITS = 25  # hidden units of the MLP and the LSTM of figures 4.4 to 5.1
A1_UNITS, A1_EPOCHS_RATIO = 30, 20 / 15  # neurons of figure A.1; its epochs as a multiple of the tables'
THESIS_ORDER: tuple[OptimiserName, ...] = ("nadam", "adam", "rmsprop", "adadelta", "sgd", "adagrad")
TABLE_SETTINGS = "settings of the tables"
# changes of the comparison's recipe, with Nadam
VARIANTS: dict[str, dict[str, Any]] = {
    TABLE_SETTINGS: {},
    "mini-batches of 32": {"batch": 32},
    "mini-batches of 256": {"batch": 256},
    "batches of 256, rate falling from 0.06, no dropout": {
        "batch": 256,
        "dropout": 0.0,
        "learning_rate": 0.06,
        "falls_to": 0.01,
    },
    "no dropout": {"dropout": 0.0},
    "weight decay, l2 = 1e-6": {"l2": 1e-6},
    "lasso, l1 = 1e-6": {"l1": 1e-6},
    "elastic net, both": {"l1": 1e-6, "l2": 1e-6},
}
Verdict = Literal["agrees", "contrary", "undecided"]


@dataclass(frozen=True)
class TrainingJob:
    """One network to train.

    Attributes:
        network: architecture.
        recipe: settings of training.
        seed: of the split, initial parameters, order and dropout; jobs with equal seeds have equal splits.
        by_condition: validate on whole conditions; the thesis validates on single pings.
    """

    network: FlatNetwork
    recipe: Recipe
    seed: int
    by_condition: bool = False

    def key(self, digest: str) -> str:
        """Return a file name that is unique to this job and these data."""
        network = {"kind": self.network.kind, "hidden": self.network.hidden}
        content = [network, asdict(self.recipe), self.seed, digest, *(["whole"] if self.by_condition else [])]
        mark = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
        return f"{self.network.kind}-{self.network.hidden}-{self.recipe.optimiser}-seed{self.seed}-{mark}"

    def run(self, samples: Samples, report: Callable[[int], None]) -> Fitted:
        """Train the network; `report` is called after each epoch with its number."""
        rng = np.random.default_rng(self.seed)
        train, validation = samples.split(rng, self.by_condition)
        return fit(self.network, train, validation, self.recipe, rng, report)


@dataclass(frozen=True)
class Comparison:
    """The networks that are compared.

    Attributes:
        recipe: settings of all networks, except for what is compared.
        seeds: number of trainings of each network.
        sizes: hidden neurons of the tables.
    """

    recipe: Recipe = field(default_factory=Recipe)
    seeds: int = 5
    sizes: tuple[int, ...] = (10, 15, 20)

    def table(self, hidden: int, optimiser: OptimiserName) -> list[TrainingJob]:
        """Return the networks of one row of a table, one per seed."""
        return self._seeded(FlatNetwork("mlp", hidden), replace(self.recipe, optimiser=optimiser))

    @cached_property
    def mlp(self) -> list[TrainingJob]:
        """The MLP of figures 4.4 to 5.1."""
        return self._seeded(FlatNetwork("mlp", FIGURE_UNITS), self.recipe)

    @cached_property
    def lstm(self) -> list[TrainingJob]:
        """The LSTM of figures 4.4 to 5.1."""
        return self._seeded(FlatNetwork("lstm", FIGURE_UNITS), self.recipe)

    @cached_property
    def a1(self) -> list[TrainingJob]:
        """The MLP of figure A.1."""
        recipe = replace(self.recipe, epochs=round(A1_EPOCHS_RATIO * self.recipe.epochs))
        return self._seeded(FlatNetwork("mlp", A1_UNITS), recipe)

    @cached_property
    def variants(self) -> dict[str, list[TrainingJob]]:
        """The largest network of the tables with other settings of training or validation, by name of the change."""
        network = FlatNetwork("mlp", self.sizes[-1])
        rows = {name: self._seeded(network, replace(self.recipe, **changes)) for name, changes in VARIANTS.items()}
        by_condition = [replace(job, by_condition=True) for job in self._seeded(network, self.recipe)]
        return {**rows, "validation on whole conditions": by_condition}

    @cached_property
    def jobs(self) -> list[TrainingJob]:
        """All different networks, seed by seed, so that an interrupted run has completed some seeds."""
        rows = [self.table(hidden, name) for hidden in self.sizes for name in OPTIMISERS]
        every = [*rows, self.mlp, self.lstm, self.a1, *self.variants.values()]
        return list(dict.fromkeys(job for seed in zip(*every, strict=True) for job in seed))

    def _seeded(self, network: FlatNetwork, recipe: Recipe) -> list[TrainingJob]:
        return [TrainingJob(network, recipe, seed) for seed in range(self.seeds)]


Progress = Callable[[TrainingJob, int, int], None]
"""Called with the current job, the number of completed epochs of all jobs, and their total."""


def train_all(
    jobs: list[TrainingJob], samples: Samples, folder: Path, report: Progress = lambda job, done, total: None
) -> dict[TrainingJob, Fitted]:
    """Train the networks whose files do not exist yet; load the others.

    Args:
        jobs: networks.
        samples: pings.
        folder: each network is written to it as soon as it is trained.
        report: called after each epoch.
    """
    mark, done, total = digest(samples), dict.fromkeys(jobs, 0), sum(job.recipe.epochs for job in jobs)

    def completed(job: TrainingJob, epoch: int) -> None:
        done[job] = epoch
        report(job, sum(done.values()), total)

    return {job: _load_or_train(job, samples, folder / f"{job.key(mark)}.safetensors", completed) for job in jobs}


def digest(samples: Samples) -> str:
    """Return a hash of the data; it distinguishes networks trained on different data."""
    return hashlib.sha256(samples.feature.tobytes() + samples.label.tobytes()).hexdigest()


def _load_or_train(
    job: TrainingJob, samples: Samples, path: Path, completed: Callable[[TrainingJob, int], None]
) -> Fitted:
    if path.exists():
        fitted = _load(job, path)
    else:
        fitted = job.run(samples, lambda epoch: completed(job, epoch))
        # safetensors writes contiguous memory, which for a strided view holds other values
        write_bytes(path, save({name: np.ascontiguousarray(getattr(fitted, name)) for name in ARRAYS}))
    completed(job, job.recipe.epochs)
    return fitted


def _load(job: TrainingJob, path: Path) -> Fitted:
    try:
        arrays = load(path.read_bytes())
        fitted = Fitted(*(arrays[name] for name in ARRAYS))
    except (SafetensorError, KeyError) as error:
        raise ModelError(f"{path}: not a network of a comparison ({error}); delete it to train it again") from None
    if fitted.theta.shape != (job.network.size,):
        raise ModelError(f"{path}: {len(fitted.theta)} parameters, expected {job.network.size}; delete it")
    return fitted


def provenance(command: Sequence[str], args: Any) -> str:
    """Return the commit and the command with those options of a dataclass `args` that differ from their defaults.

    Paths are not options here: `command` names those that matter.
    """
    words = ["sonar-gym", *command]
    for f in fields(args):
        value = getattr(args, f.name)
        if not isinstance(value, Path) and value != f.default:
            words += [f"--{f.name.replace('_', '-')}", *map(str, value if isinstance(value, tuple) else [value])]
    return f"Made by `{shlex.join(words)}` at commit {commit()}"


MIN_SEEDS = 5  # of a spread that is shown


@dataclass(frozen=True)
class SeedMean:
    """Mean over seeds with the half-width of its 95 % interval (Student's t); NaN below `MIN_SEEDS` seeds."""

    value: float
    half_width: float

    @classmethod
    def of(cls, values: Sequence[float] | Floats) -> SeedMean:
        """Return the mean of one value per seed."""
        n = len(values)
        enough = n >= MIN_SEEDS
        half_width = float(t.ppf(0.975, n - 1) * np.std(values, ddof=1) / np.sqrt(n)) if enough else math.nan
        return cls(float(np.mean(values)), half_width)

    def __str__(self) -> str:
        return self.shown(4)

    def shown(self, digits: int) -> str:
        """Return the mean, with its half-width if there are enough seeds."""
        spread = "" if math.isnan(self.half_width) else f" ± {self.half_width:.{digits}f}"
        return f"{self.value:.{digits}f}{spread}"

    def verdict(self) -> Verdict:
        """Return whether the mean is significantly positive ("agrees") or negative; undecided below `MIN_SEEDS`."""
        if not abs(self.value) > self.half_width:
            return "undecided"
        return "agrees" if self.value > 0.0 else "contrary"


@dataclass(frozen=True)
class Claim:
    """A statement of the thesis, the result of the comparison, and whether they agree."""

    thesis: str
    here: str
    verdict: Verdict

    @classmethod
    def of(cls, thesis: str, here: str, mean: SeedMean) -> Claim:
        """Return a claim that a mean is positive; `here` has a place for the mean."""
        return cls(thesis, here.format(mean), mean.verdict())


@dataclass(frozen=True, eq=False)
class ThesisFindings:
    """Results of a comparison.

    Attributes:
        comparison: the networks.
        fitted: result of training of each.
        samples: all pings.
    """

    comparison: Comparison
    fitted: dict[TrainingJob, Fitted]
    samples: Samples

    def final(
        self, jobs: list[TrainingJob], quantity: Literal["train", "validation", "seconds"] = "validation"
    ) -> Floats:
        """Return a quantity after the last epoch of each network, (n_seeds,)."""
        return np.array([getattr(self.fitted[job], quantity)[-1] for job in jobs])

    def curves(self, jobs: list[TrainingJob], quantity: Literal["train", "validation"]) -> Floats:
        """Return the losses after each epoch, (n_seeds, n_epochs); constant after an early stop."""
        epochs, losses = jobs[0].recipe.epochs, [getattr(self.fitted[job], quantity) for job in jobs]
        return np.array([np.pad(one, (0, epochs - len(one)), mode="edge") for one in losses])

    def losses(self, hidden: int) -> Floats:
        """Return the final validation losses of a table, (n_optimisers, n_seeds)."""
        return np.array([self.final(self.comparison.table(hidden, name)) for name in OPTIMISERS])

    def ranks(self, hidden: int) -> dict[OptimiserName, int]:
        """Return the rank of each optimiser in a table, 1 for the lowest validation loss."""
        ranks = rankdata(self.losses(hidden).mean(axis=1), method="ordinal")
        return {name: int(rank) for name, rank in zip(OPTIMISERS, ranks, strict=True)}

    def agreement(self, hidden: int) -> tuple[float, float, Floats]:
        """Return Spearman's and Kendall's correlation with the thesis's table, and Spearman's of each seed."""
        printed = np.array([TABLES[hidden][name].validation for name in OPTIMISERS])
        losses = self.losses(hidden)
        rho, tau = spearmanr(printed, losses.mean(axis=1))[0], kendalltau(printed, losses.mean(axis=1))[0]
        return float(rho), float(tau), np.array([spearmanr(printed, seed)[0] for seed in losses.T])

    @cached_property
    def surfaces(self) -> CredenceSurfaces:
        """Credence of the readings and of the outputs of the networks of figures 4.5 to 5.1."""
        groups = {"MLP": self.comparison.mlp, "LSTM": self.comparison.lstm}
        networks = {k: (jobs[0].network, [self.fitted[job].theta for job in jobs]) for k, jobs in groups.items()}
        return CredenceSurfaces(self.samples, networks)

    def claims(self) -> list[Claim]:
        """Return the thesis's statements on its networks, each with the result of the comparison."""
        ranking = [self._ends_lower(better, worse) for better, worse in pairwise(THESIS_ORDER)]
        return [*ranking, *self._sizes(), self._first_epoch(), *self._lstm(), self._batches(), *self._mapping()]

    def _ends_lower(self, better: OptimiserName, worse: OptimiserName) -> Claim:
        table, final = self.comparison.table, self.final
        gaps = [final(table(hidden, worse)) - final(table(hidden, better)) for hidden in self.comparison.sizes]
        thesis = f"{OPTIMISERS[better].title} ends lower than {OPTIMISERS[worse].title}"
        return Claim.of(thesis, "by {}, mean over sizes", SeedMean.of(np.mean(gaps, axis=0)))

    def _sizes(self) -> list[Claim]:
        sizes = self.comparison.sizes
        if len(sizes) < 2:
            return []
        small, large = (self.final(self.comparison.table(hidden, "nadam")) for hidden in (sizes[0], sizes[-1]))
        thesis = f"{sizes[-1]} neurons end lower than {sizes[0]} (Nadam)"
        return [Claim.of(thesis, "by {}", SeedMean.of(small - large))]

    def _first_epoch(self) -> Claim:
        hidden = self.comparison.sizes[-1]
        first = {name: self.curves(self.comparison.table(hidden, name), "validation")[:, 0] for name in OPTIMISERS}
        second = min((name for name in first if name != "nadam"), key=lambda name: float(first[name].mean()))
        here = f"lower than the next, {OPTIMISERS[second].title}, by {{}} ({hidden} neurons)"
        return Claim.of("Nadam is lowest after the first epoch", here, SeedMean.of(first[second] - first["nadam"]))

    def _lstm(self) -> list[Claim]:
        mlp, lstm = self.comparison.mlp, self.comparison.lstm
        ratio = float(np.median(self.final(lstm, "seconds") / self.final(mlp, "seconds")))
        time = f"{ratio:.1f} times as long; each is compiled for its own architecture"
        verdict: Verdict = "agrees" if 2 / 3 < ratio / LSTM_TIME_RATIO < 1.5 else "contrary"
        gap = SeedMean.of(self.final(mlp) - self.final(lstm))
        return [
            Claim.of("the LSTM ends lower than the MLP with as many units", "by {}", gap),
            Claim("the LSTM takes almost 5 times as long as the MLP", time, verdict),
        ]

    def _batches(self) -> Claim:
        """Compare at Keras's learning rates only, as the thesis did; the table has mini-batches at another rate."""
        variants = self.comparison.variants
        base = self.final(variants[TABLE_SETTINGS])
        gaps = [self.final(jobs) - base for name, jobs in variants.items() if name.startswith("mini-batches")]
        here = "the better mini-batches end higher by {}"
        return Claim.of("mini-batches are no better than online", here, SeedMean.of(np.min(gaps, axis=0)))

    def _mapping(self) -> list[Claim]:
        surfaces = self.surfaces
        mirror, rubber, near = surfaces.of(MIRROR), surfaces.of(RUBBER), surfaces.distance < SHORT_RANGE_M
        gaps = [surfaces.mean(name, mirror) - surfaces.mean(name, rubber) for name in surfaces.networks]
        short = surfaces.mean("LSTM", mirror & near) - surfaces.mean("MLP", mirror & near)
        higher = "mapped credence higher by {}"
        return [
            Claim.of("both networks map the mirror better", f"{higher} at least", SeedMean.of(np.min(gaps, axis=0))),
            Claim.of("at short range the LSTM maps the mirror better", higher, SeedMean.of(short)),
        ]
