"""Training of one network, online or in mini-batches, with the six optimisers of the thesis.

The optimisers are torch's own rules with the settings of Keras 1.0.8. The published networks state those of Nadam
(learning rate 0.002, betas 0.9 and 0.999, epsilon 1e-8, schedule 0.004); the others are the defaults of Keras 1, which
are the values in section 2.2.3 of the thesis. One negligible difference remains: Keras adds Adam's epsilon before the
bias correction of the second moment, torch after it, so at step t Keras has 1e-8 / sqrt(1 - 0.999^t) where torch has
1e-8. The thesis prints the momentum schedule 0.99 (1 - 0.5 * 0.96^(t / 250)); its files have 0.9 in place of 0.99.
"""

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
from training.thesis.data import Floats, OptimiserName, Samples, Singles
from training.thesis.networks import FlatNetwork
from training.thesis.online import GRADIENTS, RULES, online_pass

Report = Callable[[int, float], None]


@dataclass(frozen=True)
class Optimiser:
    """An update rule of torch.

    Attributes:
        title: name in the tables of the thesis.
        rule: class of torch.
        settings: its arguments: the values of Keras 1 under torch's names.
    """

    title: str
    rule: Callable[..., torch.optim.Optimizer]
    settings: dict[str, Any]

    def of(self, theta: torch.Tensor, learning_rate: float | None = None) -> torch.optim.Optimizer:
        """Return the optimiser of a weight vector; `learning_rate` replaces the default of Keras."""
        return self.rule([theta], **self.with_rate(learning_rate))

    def with_rate(self, learning_rate: float | None) -> dict[str, Any]:
        """Return the settings, with `learning_rate` in place of the default if given."""
        return self.settings | ({} if learning_rate is None else {"lr": learning_rate})


# in the order of tables 4.2 to 4.4
OPTIMISERS: dict[OptimiserName, Optimiser] = {
    "sgd": Optimiser("SGD", torch.optim.SGD, {"lr": 0.01}),
    "adagrad": Optimiser("ADAGRAD", torch.optim.Adagrad, {"lr": 0.01, "eps": 1e-8}),
    "adadelta": Optimiser("ADADELTA", torch.optim.Adadelta, {"lr": 1.0, "rho": 0.95, "eps": 1e-8}),
    "adam": Optimiser("ADAM", torch.optim.Adam, {"lr": 0.001, "betas": (0.9, 0.999), "eps": 1e-8}),
    "rmsprop": Optimiser("RMSProp", torch.optim.RMSprop, {"lr": 0.001, "alpha": 0.9, "eps": 1e-8}),
    "nadam": Optimiser(
        "NADAM", torch.optim.NAdam, {"lr": 0.002, "betas": (0.9, 0.999), "eps": 1e-8, "momentum_decay": 0.004}
    ),
}


@dataclass(frozen=True)
class Recipe:
    """Settings of training; the defaults are those of the thesis.

    Attributes:
        optimiser: key of `OPTIMISERS`.
        epochs: maximum number of passes over the training pings.
        batch: pings per step; 1 is online training.
        dropout: fraction of hidden units dropped at each step.
        l1: weight of sum |w| in the objective; with `l2`, an elastic net.
        l2: weight of sum w^2. The thesis mentions weight decay without a value; its published networks have none.
        patience: passes without a lower validation loss after which training stops; None: no early stopping.
        device: torch device: cpu, cuda, cuda:1.
        learning_rate: initial learning rate; None: the default of Keras for the optimiser.
        falls_to: final learning rate as a fraction of the initial one, reached along a cosine; 1 keeps it constant.
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
        """Raise SettingError for invalid values."""
        if self.optimiser not in OPTIMISERS:
            raise SettingError(f"optimiser {self.optimiser!r} is not one of {', '.join(OPTIMISERS)}")
        for name, low, high in LIMITS:
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise SettingError(f"{name} {value:g} must lie between {low:g} and {high:g}")

    @property
    def compiled(self) -> bool:
        """Whether to use compiled training: one step per ping on the CPU, where the overhead of torch dominates."""
        return self.batch == 1 and self.device == "cpu"

    def penalty(self, network: FlatNetwork) -> Singles:
        """Return the weights of |w| and w^2 for each parameter, (2, size); 0 for biases."""
        return np.outer([self.l1, self.l2], network.penalised).astype(np.float32)

    def rate(self, epoch: int) -> float:
        """Return the learning rate as a fraction of the initial one in a pass, counted from 0."""
        progress = epoch / max(self.epochs - 1, 1)
        return self.falls_to + (1.0 - self.falls_to) * 0.5 * (1.0 + float(np.cos(np.pi * progress)))


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


@dataclass(frozen=True, eq=False)
class TrainingResult:
    """A trained network and its learning curves.

    Attributes:
        theta: the weights with the lowest validation loss, (size,).
        train: mean squared error during each pass, with dropout, (passes,).
        validation: mean squared error after each pass, without dropout, (passes,).
        seconds: time from the start to the end of each pass, validation included, (passes,).
    """

    theta: Singles
    train: Floats
    validation: Floats
    seconds: Floats


class Trainer(Protocol):
    """A network in training."""

    theta: Singles

    def run(self, order: NDArray[np.int64], rate: float) -> float:
        """Make one pass in an order, at a fraction of the initial learning rate; return the mean squared error."""
        ...


class OnlineTrainer:
    """Compiled training with one step per ping."""

    def __init__(
        self, network: FlatNetwork, samples: Samples, recipe: Recipe, theta: Singles, rng: np.random.Generator
    ) -> None:
        self.theta, self._samples, self._rng = theta, samples, rng
        self._functions = GRADIENTS[network.kind], RULES[recipe.optimiser]
        self._settings = rule_settings(recipe)
        self._hidden, self._dropout, self._penalty = network.hidden, recipe.dropout, recipe.penalty(network)
        self._memory, self._clock = np.zeros((2, network.size), np.float32), np.array([0.0, 1.0])

    def run(self, order: NDArray[np.int64], rate: float) -> float:
        """Make one pass."""
        settings = np.concatenate([rate * self._settings[:1], self._settings[1:]])
        loss = online_pass(
            *(*self._functions, self.theta, self._memory, self._clock, settings),
            *(self._samples.feature, self._samples.label, order, self._mask(len(order)), self._penalty),
        )
        return float(loss)

    def _mask(self, steps: int) -> Singles:
        active = self._rng.random((steps, self._hidden), dtype=np.float32) >= self._dropout
        return active.astype(np.float32) / np.float32(1.0 - self._dropout)


def rule_settings(recipe: Recipe) -> Floats:
    """Return the settings of a recipe's compiled rule, the learning rate first."""
    settings = OPTIMISERS[recipe.optimiser].with_rate(recipe.learning_rate)
    return np.hstack(list(settings.values())).astype(np.float64)


class MiniBatchTrainer:
    """Training with torch, one step per mini-batch, on any device."""

    def __init__(
        self, network: FlatNetwork, samples: Samples, recipe: Recipe, theta: Singles, rng: np.random.Generator
    ) -> None:
        self._network, self._recipe, self._device = network, recipe, device_of(recipe.device)
        self._theta = torch.tensor(theta, device=self._device, requires_grad=True)
        self._feature, self._label, self._penalty = (
            torch.from_numpy(array).to(self._device)
            for array in (samples.feature, samples.label, recipe.penalty(network))
        )
        self._optimiser = OPTIMISERS[recipe.optimiser].of(self._theta, recipe.learning_rate)
        self._initial_rate = self._optimiser.param_groups[0]["lr"]
        self._random = torch.Generator(self._device).manual_seed(int(rng.integers(2**62)))

    @property
    def theta(self) -> Singles:
        """A copy of the current weights."""
        return self._theta.detach().cpu().numpy().copy()

    def run(self, order: NDArray[np.int64], rate: float) -> float:
        """Make one pass."""
        self._optimiser.param_groups[0]["lr"] = rate * self._initial_rate
        rows = torch.from_numpy(order).to(self._device)
        losses = [self._step(part) * len(part) for part in torch.split(rows, self._recipe.batch)]
        return float(torch.stack(losses).sum()) / len(order)

    def _step(self, rows: torch.Tensor) -> torch.Tensor:
        self._optimiser.zero_grad()
        output = self._network.output(self._theta, self._feature[rows], self._mask(len(rows)))
        loss = torch.mean((output - self._label[rows]) ** 2)
        (loss + self._decay()).backward()
        self._optimiser.step()
        return loss.detach()

    def _decay(self) -> torch.Tensor | float:
        if self._recipe.l1 == self._recipe.l2 == 0.0:
            return 0.0
        return self._penalty[0] @ torch.abs(self._theta) + self._penalty[1] @ self._theta**2

    def _mask(self, pings: int) -> torch.Tensor | None:
        if self._recipe.dropout == 0.0:
            return None
        draw = torch.rand((pings, self._network.hidden), generator=self._random, device=self._device)
        return (draw >= self._recipe.dropout) / (1.0 - self._recipe.dropout)


def device_of(name: str) -> torch.device:
    """Return a torch device.

    Raises:
        SettingError: the device is not available.
    """
    try:
        torch.empty(0, device=name)
        return torch.device(name)
    except (RuntimeError, AssertionError) as error:
        raise SettingError(f"device {name!r} is not available ({str(error).splitlines()[0]}): try cpu") from None


def fit(
    network: FlatNetwork,
    train: Samples,
    validation: Samples,
    recipe: Recipe,
    rng: np.random.Generator,
    report: Report = lambda epoch, loss: None,
) -> TrainingResult:
    """Train a network.

    Args:
        network: its architecture.
        train: training pings, shuffled before each pass.
        validation: validation pings, used only to select the best weights.
        recipe: settings of training.
        rng: random generator of initial weights, order of pings and dropout.
        report: called after each pass with its number and the validation loss.

    Raises:
        SettingError: training diverged.
    """
    with fast_floats():
        trainer = _trainer(network, train, recipe, rng)
        start, rows, best = time.perf_counter(), list[tuple[float, float, float]](), trainer.theta.copy()
        for epoch in range(recipe.epochs):
            train_loss = trainer.run(rng.permutation(len(train)), recipe.rate(epoch))
            loss = mean_squared_error(network, trainer.theta, validation)
            if not np.isfinite(loss):
                raise SettingError(f"training diverged in pass {epoch + 1}: lower the learning rate of {recipe}")
            if loss < min((row[1] for row in rows), default=np.inf):
                best = trainer.theta.copy()
            rows.append((train_loss, loss, time.perf_counter() - start))
            report(epoch + 1, loss)
            if _out_of_patience(recipe, [row[1] for row in rows]):
                break
    return TrainingResult(best, *np.array(rows).T)


def _trainer(network: FlatNetwork, samples: Samples, recipe: Recipe, rng: np.random.Generator) -> Trainer:
    trainer: Any = OnlineTrainer if recipe.compiled else MiniBatchTrainer
    return trainer(network, samples, recipe, network.initial(rng), rng)


def _out_of_patience(recipe: Recipe, losses: list[float]) -> bool:
    return recipe.patience is not None and len(losses) - 1 - int(np.argmin(losses)) >= recipe.patience


def mean_squared_error(network: FlatNetwork, theta: Singles, samples: Samples) -> float:
    """Return the loss without dropout."""
    error = network.predict(theta, samples.feature).astype(np.float64) - samples.label
    return float(np.mean(error**2))


@contextmanager
def fast_floats() -> Iterator[None]:
    """Restrict torch to one thread and flush denormal numbers to zero.

    The moments of a weight with zero gradient decay towards zero, and x86 takes about a hundred times as long to
    multiply denormal numbers: without flushing, Nadam's passes over an LSTM are six times slower.
    """
    torch.set_flush_denormal(True)
    try:
        with one_thread():
            yield
    finally:
        torch.set_flush_denormal(False)
