"""The networks of a comparison: which there are, each trained once and kept, so that a killed run goes on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from acquisition import ModelError
from acquisition.io.files import write_bytes
from training.thesis.data import Samples
from training.thesis.fit import Fitted, Recipe, fit
from training.thesis.networks import Network
from training.thesis.optimisers import OPTIMISERS, OptimiserName

FIELDS = ("theta", "train", "validation", "seconds")


@dataclass(frozen=True)
class Job:
    """One network to train.

    Attributes:
        network: its shape.
        recipe: how.
        seed: of the split, the first weights, the order and what is dropped; equal seeds meet equal splits.
        whole: validate on whole conditions held out rather than, as the thesis, on single pings.
    """

    network: Network
    recipe: Recipe
    seed: int
    whole: bool = False

    def key(self, digest: str) -> str:
        """Return a file name that no other job on no other data has."""
        network = {"kind": self.network.kind, "hidden": self.network.hidden}
        what = [network, asdict(self.recipe), self.seed, digest, *(["whole"] if self.whole else [])]
        text = json.dumps(what, sort_keys=True)
        mark = hashlib.sha256(text.encode()).hexdigest()[:12]
        return f"{self.network.kind}-{self.network.hidden}-{self.recipe.optimiser}-seed{self.seed}-{mark}"

    def run(self, samples: Samples, report: Callable[[int, float], None]) -> Fitted:
        """Train it."""
        rng = np.random.default_rng(self.seed)
        train, validation = samples.split(rng, self.whole)
        return fit(self.network, train, validation, self.recipe, rng, report)


@dataclass(frozen=True)
class Comparison:
    """Which networks are compared.

    Attributes:
        recipe: of them all, but for what is compared.
        seeds: how often each is trained.
        sizes: hidden neurons of the tables.
        figure: hidden units of the MLP and the LSTM of figures 4.4 to 5.1.
        longest: neurons of the network of figure A.1, and its passes for each of the tables' passes.
    """

    recipe: Recipe = field(default_factory=Recipe)
    seeds: int = 5
    sizes: tuple[int, ...] = (10, 15, 20)
    figure: int = 25
    longest: tuple[int, float] = (30, 20 / 15)

    def table(self, hidden: int, optimiser: OptimiserName) -> list[Job]:
        """Return the networks of one row of a table, one a seed."""
        return self._seeded(Network("mlp", hidden), replace(self.recipe, optimiser=optimiser))

    @cached_property
    def mlp(self) -> list[Job]:
        """The MLP of figures 4.4 to 5.1."""
        return self._seeded(Network("mlp", self.figure), self.recipe)

    @cached_property
    def lstm(self) -> list[Job]:
        """The LSTM of figures 4.4 to 5.1."""
        return self._seeded(Network("lstm", self.figure), self.recipe)

    @cached_property
    def long(self) -> list[Job]:
        """The MLP of figure A.1."""
        hidden, times = self.longest
        return self._seeded(Network("mlp", hidden), replace(self.recipe, epochs=round(times * self.recipe.epochs)))

    @cached_property
    def variants(self) -> dict[str, list[Job]]:
        """Other ways to train, or to validate, the largest network of the tables, by what is changed."""
        network = Network("mlp", self.sizes[-1])
        changed = {name: replace(self.recipe, **changes) for name, changes in VARIANTS.items()}
        rows = {name: self._seeded(network, recipe) for name, recipe in changed.items()}
        whole = [replace(job, whole=True) for job in self._seeded(network, self.recipe)]
        return {**rows, "whole conditions held out": whole}

    @cached_property
    def jobs(self) -> list[Job]:
        """All networks, each once, seed by seed, so that a run cut short has whole comparisons of some seeds."""
        rows = [self.table(hidden, name) for hidden in self.sizes for name in OPTIMISERS]
        every = [*rows, self.mlp, self.lstm, self.long, *self.variants.values()]
        return list(dict.fromkeys(job for seed in zip(*every, strict=True) for job in seed))

    def _seeded(self, network: Network, recipe: Recipe) -> list[Job]:
        return [Job(network, recipe, seed) for seed in range(self.seeds)]


# what is changed from the comparison's recipe, with Nadam
VARIANTS: dict[str, dict[str, Any]] = {
    "as the tables": {},
    "mini-batches of 32": {"batch": 32},
    "mini-batches of 256": {"batch": 256},
    "256, rate 0.06 that falls, no dropout": {"batch": 256, "dropout": 0.0, "learning_rate": 0.06, "falls_to": 0.01},
    "no dropout": {"dropout": 0.0},
    "weight decay, l2 = 1e-6": {"l2": 1e-6},
    "lasso, l1 = 1e-6": {"l1": 1e-6},
    "elastic net, both": {"l1": 1e-6, "l2": 1e-6},
}


def digest(samples: Samples) -> str:
    """Return a mark of the data, so that networks of other data are never taken for these."""
    return hashlib.sha256(samples.feature.tobytes() + samples.label.tobytes()).hexdigest()


def train_all(
    jobs: list[Job], samples: Samples, folder: Path, report: Callable[[Job, int], None] = lambda job, epoch: None
) -> dict[Job, Fitted]:
    """Train networks, but for those that lie in the folder already.

    Args:
        jobs: which networks.
        samples: to learn from.
        folder: where each network is written as soon as it is trained.
        report: called after each pass with its number, and with the last one of networks that were there.
    """
    mark = digest(samples)
    return {job: _kept(job, samples, folder / f"{job.key(mark)}.safetensors", report) for job in jobs}


def _kept(job: Job, samples: Samples, path: Path, report: Callable[[Job, int], None]) -> Fitted:
    if path.exists():
        report(job, job.recipe.epochs)
        return _loaded(job, path)
    fitted = job.run(samples, lambda epoch, loss: report(job, epoch))
    # safetensors writes the memory that an array begins at, so a strided view would be kept as its neighbours
    write_bytes(path, save({name: np.ascontiguousarray(getattr(fitted, name)) for name in FIELDS}))
    report(job, job.recipe.epochs)
    return fitted


def _loaded(job: Job, path: Path) -> Fitted:
    try:
        arrays = load(path.read_bytes())
        fitted = Fitted(*(arrays[name] for name in FIELDS))
    except (SafetensorError, KeyError) as error:
        raise ModelError(f"{path}: is no network of a comparison ({error}); delete it to train it anew") from None
    if fitted.theta.shape != (job.network.size,):
        raise ModelError(f"{path}: holds {len(fitted.theta)} weights, not {job.network.size}; delete it")
    return fitted
