"""The networks of the comparison, their training with results saved to files, and tests of the thesis's claims."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from functools import cached_property
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
from training.thesis.fit import OPTIMISERS, Recipe, TrainingResult, fit
from training.thesis.networks import FlatNetwork, Kind
from training.thesis.surfaces import MIRROR, RUBBER, SHORT_RANGE, CredenceSurfaces

ARRAYS = ("theta", "train", "validation", "seconds")
Verdict = Literal["agrees", "contrary", "undecided"]
Curve = Literal["train", "validation"]


@dataclass(frozen=True)
class TrainingJob:
    """One network to train.

    Attributes:
        network: architecture.
        recipe: settings of training.
        seed: seed of split, initial weights, order and dropout; equal seeds have equal splits.
        by_condition: validate on whole conditions instead of, as the thesis, on single pings.
    """

    network: FlatNetwork
    recipe: Recipe
    seed: int
    by_condition: bool = False

    def key(self, digest: str) -> str:
        """Return a file name that is unique to this job and data."""
        network = {"kind": self.network.kind, "hidden": self.network.hidden}
        content = [network, asdict(self.recipe), self.seed, digest, *(["whole"] if self.by_condition else [])]
        suffix = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
        return f"{self.network.kind}-{self.network.hidden}-{self.recipe.optimiser}-seed{self.seed}-{suffix}"

    def run(self, samples: Samples, report: Callable[[int, float], None]) -> TrainingResult:
        """Split the samples and train the network."""
        rng = np.random.default_rng(self.seed)
        train, validation = samples.split(rng, self.by_condition)
        return fit(self.network, train, validation, self.recipe, rng, report)


# changes to the recipe of the comparison, with Nadam
VARIANTS: dict[str, dict[str, Any]] = {
    "as the tables": {},
    "mini-batches of 32": {"batch": 32},
    "mini-batches of 256": {"batch": 256},
    "256, falling rate from 0.06, no dropout": {"batch": 256, "dropout": 0.0, "learning_rate": 0.06, "falls_to": 0.01},
    "no dropout": {"dropout": 0.0},
    "weight decay, l2 = 1e-6": {"l2": 1e-6},
    "lasso, l1 = 1e-6": {"l1": 1e-6},
    "elastic net, both": {"l1": 1e-6, "l2": 1e-6},
}


@dataclass(frozen=True)
class Comparison:
    """The networks of the comparison; each list of jobs has one job per seed.

    Attributes:
        recipe: common settings of training.
        seeds: number of seeds.
        sizes: hidden neurons of the tables.
        figure: hidden units of the MLP and the LSTM of figures 4.4 to 5.1.
        longest: hidden neurons of figure A.1, and the ratio of its number of passes to that of the tables.
    """

    recipe: Recipe = field(default_factory=Recipe)
    seeds: int = 5
    sizes: tuple[int, ...] = (10, 15, 20)
    figure: int = 25
    longest: tuple[int, float] = (30, 20 / 15)

    def table(self, hidden: int, optimiser: OptimiserName) -> list[TrainingJob]:
        """Return the networks of one row of a table."""
        return self._jobs("mlp", hidden, optimiser=optimiser)

    @cached_property
    def mlp(self) -> list[TrainingJob]:
        """The MLP of figures 4.4 to 5.1."""
        return self._jobs("mlp", self.figure)

    @cached_property
    def lstm(self) -> list[TrainingJob]:
        """The LSTM of figures 4.4 to 5.1."""
        return self._jobs("lstm", self.figure)

    @cached_property
    def long(self) -> list[TrainingJob]:
        """The MLP of figure A.1."""
        hidden, ratio = self.longest
        return self._jobs("mlp", hidden, epochs=round(ratio * self.recipe.epochs))

    @cached_property
    def variants(self) -> dict[str, list[TrainingJob]]:
        """Other ways to train or validate the last network of the tables, by description of the change."""
        rows = {name: self._jobs("mlp", self.sizes[-1], **changes) for name, changes in VARIANTS.items()}
        by_condition = [replace(job, by_condition=True) for job in self._jobs("mlp", self.sizes[-1])]
        return {**rows, "validation on whole conditions": by_condition}

    @cached_property
    def jobs(self) -> list[TrainingJob]:
        """All networks without repetition, ordered by seed, so that an interrupted run completes some seeds."""
        rows = [self.table(hidden, name) for hidden in self.sizes for name in OPTIMISERS]
        rows += [self.mlp, self.lstm, self.long, *self.variants.values()]
        return list(dict.fromkeys(job for seed in zip(*rows, strict=True) for job in seed))

    def _jobs(self, kind: Kind, hidden: int, **changes: Any) -> list[TrainingJob]:
        recipe = replace(self.recipe, **changes)
        return [TrainingJob(FlatNetwork(kind, hidden), recipe, seed) for seed in range(self.seeds)]


def digest(samples: Samples) -> str:
    """Return a hash of the data, which distinguishes networks of different data."""
    return hashlib.sha256(samples.feature.tobytes() + samples.label.tobytes()).hexdigest()


def train_all(
    jobs: list[TrainingJob],
    samples: Samples,
    folder: Path,
    report: Callable[[TrainingJob, int, int], None] = lambda job, done, total: None,
) -> dict[TrainingJob, TrainingResult]:
    """Train the networks that are not in a folder yet, and load the others.

    Args:
        jobs: networks.
        samples: data.
        folder: where each network is written as soon as it is trained.
        report: called after each pass with the job, and the completed and total number of passes of all jobs.
    """
    data, done = digest(samples), dict.fromkeys(jobs, 0)

    def passed(job: TrainingJob, epoch: int) -> None:
        done[job] = epoch
        report(job, sum(done.values()), sum(job.recipe.epochs for job in jobs))

    return {job: _trained(job, samples, folder / f"{job.key(data)}.safetensors", passed) for job in jobs}


def _trained(
    job: TrainingJob, samples: Samples, path: Path, report: Callable[[TrainingJob, int], None]
) -> TrainingResult:
    if path.exists():
        result = _loaded(job, path)
    else:
        result = job.run(samples, lambda epoch, loss: report(job, epoch))
        # safetensors writes the underlying memory, which is wrong for a strided view
        write_bytes(path, save({name: np.ascontiguousarray(getattr(result, name)) for name in ARRAYS}))
    report(job, job.recipe.epochs)
    return result


def _loaded(job: TrainingJob, path: Path) -> TrainingResult:
    try:
        arrays = load(path.read_bytes())
        result = TrainingResult(*(arrays[name] for name in ARRAYS))
    except (SafetensorError, KeyError) as error:
        raise ModelError(f"{path}: not a network of a comparison ({error}); delete it to train it again") from None
    if result.theta.shape != (job.network.size,):
        raise ModelError(f"{path}: {len(result.theta)} weights, expected {job.network.size}; delete it")
    return result


def made_by(command: str, words: Sequence[str], args: Any) -> str:
    """Return the command and the commit that made a page.

    Args:
        command: command of `sonar-gym`.
        words: its required arguments.
        args: all arguments (dataclass); options that differ from their default are shown, except `page`.
    """
    shown = ["sonar-gym", command, *words]
    for f in fields(args):
        value = getattr(args, f.name)
        if f.name != "page" and f.default is not MISSING and value != f.default:
            shown += [f"--{f.name.replace('_', '-')}", *map(str, value if isinstance(value, tuple) else [value])]
    return f"Made by `{shlex.join(shown)}` at commit {commit()}"


@dataclass(frozen=True)
class Mean:
    """A mean over seeds.

    Attributes:
        value: mean.
        half: half width of the 95 % interval (Student's t); 0 for one seed.
    """

    value: float
    half: float

    @classmethod
    def of(cls, values: Sequence[float] | Floats) -> Mean:
        """Return the mean of one value per seed."""
        n = len(values)
        half = float(t.ppf(0.975, n - 1) * np.std(values, ddof=1) / np.sqrt(n)) if n > 1 else 0.0
        return cls(float(np.mean(values)), half)

    def __str__(self) -> str:
        return f"{self.value:.4f} ± {self.half:.4f}"

    def verdict(self) -> Verdict:
        """Return whether the interval is above zero, below zero, or contains it; one seed is undecided."""
        if self.half == 0.0 or not abs(self.value) > self.half:
            return "undecided"
        return "agrees" if self.value > 0.0 else "contrary"


@dataclass(frozen=True)
class Claim:
    """A claim of the thesis and the result here."""

    thesis: str
    here: str
    verdict: Verdict

    @classmethod
    def of(cls, thesis: str, here: str, values: Floats) -> Claim:
        """Return the verdict on values, one per seed, that are positive if the claim is true.

        Args:
            thesis: the claim.
            here: the result; "{}" stands for the mean of the values.
            values: (seeds,).
        """
        mean = Mean.of(values)
        return cls(thesis, here.format(mean), mean.verdict())


@dataclass(frozen=True, eq=False)
class ThesisFindings:
    """Results of a comparison.

    Attributes:
        comparison: the networks.
        results: result of training of each job.
        samples: all pings.
    """

    comparison: Comparison
    results: dict[TrainingJob, TrainingResult]
    samples: Samples

    def final(self, jobs: list[TrainingJob], name: Literal["train", "validation", "seconds"] = "validation") -> Floats:
        """Return a loss or the time after the last pass, (seeds,)."""
        return np.array([getattr(self.results[job], name)[-1] for job in jobs])

    def curves(self, jobs: list[TrainingJob], name: Curve) -> Floats:
        """Return the losses after each pass, (seeds, passes); after an early stop the last one is repeated."""
        passes, losses = jobs[0].recipe.epochs, [getattr(self.results[job], name) for job in jobs]
        return np.array([np.pad(one, (0, passes - len(one)), mode="edge") for one in losses])

    def losses(self, hidden: int) -> Floats:
        """Return the final validation losses of a table, (optimisers, seeds)."""
        return np.array([self.final(self.comparison.table(hidden, name)) for name in OPTIMISERS])

    def ranks(self, hidden: int) -> dict[OptimiserName, int]:
        """Return the rank of each optimiser in a table; 1 has the lowest validation loss."""
        order = rankdata(self.losses(hidden).mean(axis=1), method="ordinal")
        return {name: int(rank) for name, rank in zip(OPTIMISERS, order, strict=True)}

    def agreement(self, hidden: int) -> tuple[float, float, Floats]:
        """Return Spearman's and Kendall's correlation with the thesis's table, and Spearman's of each seed."""
        printed = np.array([TABLES[hidden][name].validation for name in OPTIMISERS])
        losses = self.losses(hidden)
        rho, tau = spearmanr(printed, losses.mean(axis=1))[0], kendalltau(printed, losses.mean(axis=1))[0]
        return float(rho), float(tau), np.array([spearmanr(printed, seed)[0] for seed in losses.T])

    @cached_property
    def surfaces(self) -> CredenceSurfaces:
        """Credence of the readings and of the estimates by the networks of figures 4.5 to 5.1."""
        pairs = {"MLP": self.comparison.mlp, "LSTM": self.comparison.lstm}
        weights = {k: (jobs[0].network, [self.results[job].theta for job in jobs]) for k, jobs in pairs.items()}
        return CredenceSurfaces(self.samples, weights)

    def claims(self) -> list[Claim]:
        """Return the claims of the thesis about its networks with the results here."""
        ranking = [self._ends_lower(better, worse) for better, worse in PAIRS]
        return [*ranking, *self._sizes(), self._first_pass(), *self._lstm(), self._batches(), *self._mapping()]

    def _ends_lower(self, better: OptimiserName, worse: OptimiserName) -> Claim:
        table, final = self.comparison.table, self.final
        gaps = [final(table(hidden, worse)) - final(table(hidden, better)) for hidden in self.comparison.sizes]
        thesis = f"{OPTIMISERS[better].title} ends lower than {OPTIMISERS[worse].title}"
        return Claim.of(thesis, "by {}, mean over sizes", np.mean(gaps, axis=0))

    def _sizes(self) -> list[Claim]:
        first, last = self.comparison.sizes[0], self.comparison.sizes[-1]
        gap = self.final(self.comparison.table(first, "nadam")) - self.final(self.comparison.table(last, "nadam"))
        claim = Claim.of(f"{last} neurons end lower than {first} (Nadam)", "by {}", gap)
        return [claim] if len(self.comparison.sizes) > 1 else []

    def _first_pass(self) -> Claim:
        hidden = self.comparison.sizes[-1]
        first = {name: self.curves(self.comparison.table(hidden, name), "validation")[:, 0] for name in OPTIMISERS}
        rival = min((name for name in first if name != "nadam"), key=lambda name: float(first[name].mean()))
        here = f"lower than the next, {OPTIMISERS[rival].title}, by {{}} ({hidden} neurons)"
        return Claim.of("after the first pass Nadam is lowest", here, first[rival] - first["nadam"])

    def _lstm(self) -> list[Claim]:
        mlp, lstm = self.comparison.mlp, self.comparison.lstm
        ratio = float(np.median(self.final(lstm, "seconds") / self.final(mlp, "seconds")))
        here = f"{ratio:.1f} times as long; each is compiled for its own shape"
        verdict: Verdict = "agrees" if 2 / 3 < ratio / LSTM_TIME_RATIO < 1.5 else "contrary"
        gap = self.final(mlp) - self.final(lstm)
        return [
            Claim.of("the LSTM ends lower than the MLP with as many units", "by {}", gap),
            Claim("the LSTM takes almost 5 times as long as the MLP", here, verdict),
        ]

    def _batches(self) -> Claim:
        """Test mini-batches at the learning rate of Keras only; the table of variants has others."""
        variants = self.comparison.variants
        gaps = [self.final(v) - self.final(variants["as the tables"]) for k, v in variants.items() if "mini" in k]
        here = "the better of them ends higher by {}"
        return Claim.of("mini-batches are no better than online training", here, np.min(gaps, axis=0))

    def _mapping(self) -> list[Claim]:
        surfaces = self.surfaces
        mirror, rubber = surfaces.of(MIRROR), surfaces.of(RUBBER)
        near = mirror & (surfaces.distance < SHORT_RANGE)
        gaps = [surfaces.mean(name, mirror) - surfaces.mean(name, rubber) for name in surfaces.networks]
        short = surfaces.mean("LSTM", near) - surfaces.mean("MLP", near)
        return [
            Claim.of(
                "both networks map the mirror better", "mapped credence higher by {} at least", np.min(gaps, axis=0)
            ),
            Claim.of("at short range the LSTM maps the mirror better", "mapped credence higher by {}", short),
        ]


# neighbours in the order of all three tables of the thesis
PAIRS: tuple[tuple[OptimiserName, OptimiserName], ...] = (
    ("nadam", "adam"),
    ("adam", "rmsprop"),
    ("rmsprop", "adadelta"),
    ("adadelta", "sgd"),
    ("sgd", "adagrad"),
)
