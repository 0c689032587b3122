"""Training one of the thesis's networks: online or in mini-batches, on the CPU or a GPU, the best weights kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from acquisition import SettingError
from noise.fitting.threads import one_thread
from training.thesis.data import Floats, Samples, Singles
from training.thesis.networks import Network
from training.thesis.online import RULES, SLOPES, learn
from training.thesis.optimisers import OPTIMISERS, OptimiserName

Report = Callable[[int, float], None]


@dataclass(frozen=True)
class Recipe:
    """How a network is trained; the defaults are the thesis's.

    Attributes:
        optimiser: of `training.thesis.optimisers`.
        epochs: most passes over the training pings.
        batch: pings a step; 1 is online.
        dropout: share of hidden units dropped at each step.
        l1: weight of sum |w| in what is made small; with `l2` together an elastic net.
        l2: weight of sum w^2. The thesis names weight decay but no weight of it, and its published networks have none.
        patience: passes without a better validation loss after which training stops; None never stops early.
        device: where torch runs: cpu, cuda, cuda:1.
        learning_rate: in place of Keras's default for the optimiser.
        falls_to: share of its first value to which the learning rate falls along a cosine; 1 keeps it, as the thesis.
    """

    optimiser: OptimiserName = "nadam"
    epochs: int = 15
    batch: int = 1
    dropout: float = 0.05
    l1: float = 0.0
    l2: float = 0.0
    patience: int | None = None
    device: str = "cpu"
    learning_rate: float | None = None
    falls_to: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what cannot be trained with."""
        if self.optimiser not in OPTIMISERS:
            raise SettingError(f"optimiser {self.optimiser!r} is not one of {', '.join(OPTIMISERS)}")
        for name, low, high in LIMITS:
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise SettingError(f"{name} {value:g} must lie between {low:g} and {high:g}")

    @property
    def compiled(self) -> bool:
        """Whether training runs compiled: a step a ping on the CPU, where calling torch would take all the time."""
        return self.batch == 1 and self.device == "cpu"

    def penalty(self, network: Network) -> Singles:
        """Return the weights of |w| and w^2 for each number of a network, (2, size); none for biases."""
        return np.outer([self.l1, self.l2], network.penalised).astype(np.float32)

    def rate(self, epoch: int) -> float:
        """Return the learning rate's share of its first value in a pass, counted from 0."""
        along = epoch / max(self.epochs - 1, 1)
        return self.falls_to + (1.0 - self.falls_to) * 0.5 * (1.0 + float(np.cos(np.pi * along)))


LIMITS = (
    ("epochs", 1, 100_000),
    ("batch", 1, 10_000_000),
    ("dropout", 0.0, 0.95),
    ("l1", 0.0, 1.0),
    ("l2", 0.0, 1.0),
    ("patience", 1, 100_000),
    ("learning_rate", 1e-9, 100.0),
    ("falls_to", 0.0, 1.0),
)
# Mini-batches that reach what 20 online passes reach, in a fraction of the steps. Ours: larger steps that fall along a
# cosine take the place of online training's scatter; dropout only holds a network of 30 neurons back.
BATCHED = Recipe(epochs=45, batch=256, dropout=0.0, learning_rate=0.06, falls_to=0.01)


@dataclass(frozen=True, eq=False)
class Fitted:
    """What training gave.

    Attributes:
        theta: the weights that were best on the validation pings, (size,).
        train: mean squared error met on the way through each pass, dropout on, (passes,).
        validation: mean squared error after each pass, dropout off, (passes,).
        seconds: from the first pass to the end of each, validation included, (passes,).
    """

    theta: Singles
    train: Floats
    validation: Floats
    seconds: Floats

    @property
    def best_epoch(self) -> int:
        """The pass that gave the weights, counted from 1."""
        return int(np.argmin(self.validation)) + 1


class Learner(Protocol):
    """A network in training."""

    theta: Singles

    def run(self, order: NDArray[np.int64], rate: float) -> float:
        """Make one pass in an order, the learning rate at a share of its first value; return the error met."""
        ...


class Online:
    """A step a ping, compiled."""

    def __init__(
        self, network: Network, samples: Samples, recipe: Recipe, theta: Singles, rng: np.random.Generator
    ) -> None:
        self.theta, self._samples, self._rng = theta, samples, rng
        self._functions = SLOPES[network.kind], RULES[recipe.optimiser]
        self._settings = rule_settings(recipe)
        self._hidden, self._dropout, self._penalty = network.hidden, recipe.dropout, recipe.penalty(network)
        self._memory, self._clock = np.zeros((2, network.size), np.float32), np.array([0.0, 1.0])

    def run(self, order: NDArray[np.int64], rate: float) -> float:
        """Make one pass."""
        samples, (slope_of, rule) = self._samples, self._functions
        settings = self._settings * np.where(np.arange(len(self._settings)) == 0, rate, 1.0)
        met = learn(
            *(slope_of, rule, self.theta, self._memory, self._clock, settings),
            *(samples.feature, samples.label, order, self._keep(len(order)), self._penalty),
        )
        return float(met)

    def _keep(self, steps: int) -> Singles:
        kept = self._rng.random((steps, self._hidden), dtype=np.float32) >= self._dropout
        return kept.astype(np.float32) / np.float32(1.0 - self._dropout)


def rule_settings(recipe: Recipe) -> Floats:
    """Return an optimiser's settings in the order of the compiled rules, the learning rate first."""
    optimiser = OPTIMISERS[recipe.optimiser]
    values = {**optimiser.settings, **({} if recipe.learning_rate is None else {"lr": recipe.learning_rate})}
    return np.hstack(list(values.values())).astype(np.float64)


class Batches:
    """A step a mini-batch, by torch on any device."""

    def __init__(
        self, network: Network, samples: Samples, recipe: Recipe, theta: Singles, rng: np.random.Generator
    ) -> None:
        self._network, self._recipe, self._device = network, recipe, device_of(recipe.device)
        self._theta = torch.tensor(theta, device=self._device, requires_grad=True)
        self._feature, self._label, self._penalty = (
            torch.from_numpy(array).to(self._device)
            for array in (samples.feature, samples.label, recipe.penalty(network))
        )
        self._optimiser = OPTIMISERS[recipe.optimiser].of(self._theta, recipe.learning_rate)
        self._first_rate = self._optimiser.param_groups[0]["lr"]
        self._random = torch.Generator(self._device).manual_seed(int(rng.integers(2**62)))

    @property
    def theta(self) -> Singles:
        """The weights as they are now."""
        return self._theta.detach().cpu().numpy().copy()

    def run(self, order: NDArray[np.int64], rate: float) -> float:
        """Make one pass."""
        self._optimiser.param_groups[0]["lr"] = rate * self._first_rate
        rows = torch.from_numpy(order).to(self._device)
        met = [self._step(part) * len(part) for part in torch.split(rows, self._recipe.batch)]
        return float(torch.stack(met).sum()) / len(order)

    def _step(self, rows: torch.Tensor) -> torch.Tensor:
        self._optimiser.zero_grad()
        output = self._network.output(self._theta, self._feature[rows], self._keep(len(rows)))
        loss = torch.mean((output - self._label[rows]) ** 2)
        (loss + self._decay()).backward()
        self._optimiser.step()
        return loss.detach()

    def _decay(self) -> torch.Tensor | float:
        if self._recipe.l1 == self._recipe.l2 == 0.0:
            return 0.0
        return self._penalty[0] @ torch.abs(self._theta) + self._penalty[1] @ self._theta**2

    def _keep(self, pings: int) -> torch.Tensor | None:
        if self._recipe.dropout == 0.0:
            return None
        draw = torch.rand((pings, self._network.hidden), generator=self._random, device=self._device)
        return (draw >= self._recipe.dropout) / (1.0 - self._recipe.dropout)


def device_of(name: str) -> torch.device:
    """Return a device of torch.

    Raises:
        SettingError: this machine, or this torch, has none of that name.
    """
    try:
        torch.empty(0, device=name)
        return torch.device(name)
    except (RuntimeError, AssertionError) as error:
        raise SettingError(f"device {name!r} cannot be used here ({str(error).splitlines()[0]}): try cpu") from None


def fit(
    network: Network,
    train: Samples,
    validation: Samples,
    recipe: Recipe,
    rng: np.random.Generator,
    report: Report = lambda epoch, loss: None,
) -> Fitted:
    """Train a network.

    Args:
        network: its shape.
        train: pings to learn from, shuffled anew before each pass.
        validation: pings by which the best weights are chosen, never learnt from.
        recipe: how to train.
        rng: of the first weights, the order of pings and what is dropped.
        report: called after each pass with its number and the validation loss.
    """
    with quick_floats():
        learner = _learner(network, train, recipe, rng)
        start, rows, best = time.perf_counter(), list[tuple[float, float, float]](), learner.theta.copy()
        for epoch in range(recipe.epochs):
            met = learner.run(rng.permutation(len(train)), recipe.rate(epoch))
            loss = mean_squared_error(network, learner.theta, validation)
            if not np.isfinite(loss):
                raise SettingError(f"training diverged in pass {epoch + 1}: lower the learning rate of {recipe}")
            if loss < min((row[1] for row in rows), default=np.inf):
                best = learner.theta.copy()
            rows.append((met, loss, time.perf_counter() - start))
            report(epoch + 1, loss)
            if _out_of_patience(recipe, [row[1] for row in rows]):
                break
    return Fitted(best, *np.array(rows).T)


def _learner(network: Network, samples: Samples, recipe: Recipe, rng: np.random.Generator) -> Learner:
    engine: Any = Online if recipe.compiled else Batches
    return engine(network, samples, recipe, network.first(rng), rng)


def _out_of_patience(recipe: Recipe, losses: list[float]) -> bool:
    return recipe.patience is not None and len(losses) - 1 - int(np.argmin(losses)) >= recipe.patience


def mean_squared_error(network: Network, theta: Singles, samples: Samples) -> float:
    """Return the loss of weights on pings, dropout off."""
    error = network.predict(theta, samples.feature).astype(np.float64) - samples.label
    return float(np.mean(error**2))


@contextmanager
def quick_floats() -> Iterator[None]:
    """Keep torch to one thread, and let numbers below 1e-38 be zero.

    The moments of a weight that is no longer moved decay towards zero for ever, and on x86 the smallest of them take a
    hundred times as long as others to multiply: without this, Nadam's passes over an LSTM get six times slower.
    """
    torch.set_flush_denormal(True)
    try:
        with one_thread():
            yield
    finally:
        torch.set_flush_denormal(False)
