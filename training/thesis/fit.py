"""Optimisers with the settings of Keras 1.0.8, and training of the thesis's networks: online or in mini-batches.

The six update rules are torch's; their settings differ from torch's defaults. Nadam's are stated in the files of the
published networks (learning rate 0.002, betas 0.9 and 0.999, epsilon 1e-8, schedule 0.004); the others are the defaults
of Keras 1, as in the thesis's section 2.2.3. One negligible difference remains: Keras adds Adam's epsilon before the
bias correction of the second moment, torch after it, so that at step t Keras has 1e-8 / sqrt(1 - 0.999^t) for torch's
1e-8. The thesis prints Nadam's momentum schedule as 0.99 (1 - 0.5 * 0.96^(t / 250)); its files have 0.9 for 0.99.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, get_args

import numpy as np
import torch
from numpy.typing import NDArray

from acquisition import SettingError
from noise.fitting.threads import one_thread
from training.thesis.data import Floats, OptimiserName, Samples, Singles
from training.thesis.networks import FlatNetwork
from training.thesis.online import GRADIENTS, RULES, learn


@dataclass(frozen=True)
class Optimiser:
    """An update rule with its settings.

    Attributes:
        title: name in the thesis's tables.
        rule: class of torch.
        settings: its arguments: Keras 1's values under torch's names.
    """

    title: str
    rule: Callable[..., torch.optim.Optimizer]
    settings: dict[str, Any]

    def arguments(self, learning_rate: float | None = None) -> dict[str, Any]:
        """Return the settings, with the learning rate replaced if one is given."""
        return self.settings | ({} if learning_rate is None else {"lr": learning_rate})

    def of(self, theta: torch.Tensor, learning_rate: float | None = None) -> torch.optim.Optimizer:
        """Return torch's optimiser of a parameter vector."""
        return self.rule([theta], **self.arguments(learning_rate))

    def values(self, learning_rate: float | None = None) -> Floats:
        """Return the settings in the order of the compiled rules, the learning rate first."""
        return np.hstack(list(self.arguments(learning_rate).values())).astype(np.float64)


# in the order of the thesis's tables 4.2 to 4.4
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
assert tuple(OPTIMISERS) == get_args(OptimiserName)


@dataclass(frozen=True)
class Recipe:
    """Settings of training; the defaults are the thesis's.

    Attributes:
        optimiser: name in `OPTIMISERS`.
        epochs: maximum number of passes over the training pings.
        batch: pings per step; 1 is online training.
        dropout: share of hidden units dropped at each step.
        l1: coefficient of sum |w| in the objective; together with `l2` an elastic net.
        l2: coefficient of sum w^2. The thesis mentions weight decay without a value; its published networks have none.
        patience: epochs without a lower validation loss after which training stops; None never stops early.
        device: torch device of mini-batches: cpu, cuda, cuda:1.
        learning_rate: initial learning rate; None is Keras's default of the optimiser.
        falls_to: ratio of final to initial learning rate; between them the rate follows a cosine. 1 is constant.
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
        """Raise SettingError for an unknown optimiser or a value out of `LIMITS`."""
        if self.optimiser not in OPTIMISERS:
            raise SettingError(f"optimiser {self.optimiser!r} is not one of {', '.join(OPTIMISERS)}")
        for name, low, high in LIMITS:
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise SettingError(f"{name} {value:g} must lie between {low:g} and {high:g}")

    @property
    def compiled(self) -> bool:
        """Whether training is compiled: one ping per step on the CPU."""
        return self.batch == 1 and self.device == "cpu"

    def penalty(self, network: FlatNetwork) -> Singles:
        """Return the coefficients of |w| and w^2 for each parameter of a network, (2, size); 0 for biases."""
        return np.outer([self.l1, self.l2], network.penalised).astype(np.float32)

    def rate_factor(self, epoch: int) -> float:
        """Return the learning rate of an epoch, counted from 0, as a factor of the initial one."""
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
class Fitted:
    """Result of training.

    Attributes:
        theta: parameters with the lowest validation loss, (size,).
        train: mean squared error before each step, with dropout, averaged over each epoch, (epochs,).
        validation: mean squared error after each epoch, without dropout, (epochs,).
        seconds: time from the start to the end of each epoch, validation included, (epochs,).
    """

    theta: Singles
    train: Floats
    validation: Floats
    seconds: Floats

    @property
    def best_epoch(self) -> int:
        """Epoch of the lowest validation loss, counted from 1."""
        return int(np.argmin(self.validation)) + 1


class Trainer(Protocol):
    """A network during training."""

    theta: Singles

    def run_epoch(self, order: NDArray[np.int64], rate_factor: float) -> float:
        """Train once on the pings in an order; return the mean squared error before each step."""
        ...


class OnlineTrainer:
    """Compiled training with one step per ping."""

    def __init__(
        self, network: FlatNetwork, samples: Samples, recipe: Recipe, theta: Singles, rng: np.random.Generator
    ) -> None:
        self.theta, self._samples, self._rng = theta, samples, rng
        self._functions = GRADIENTS[network.kind], RULES[recipe.optimiser]
        self._settings = OPTIMISERS[recipe.optimiser].values(recipe.learning_rate)
        self._hidden, self._dropout, self._penalty = network.hidden, recipe.dropout, recipe.penalty(network)
        self._accumulators, self._counters = np.zeros((2, network.size), np.float32), np.array([0.0, 1.0])

    def run_epoch(self, order: NDArray[np.int64], rate_factor: float) -> float:
        """Train once on the pings in an order."""
        settings = np.concatenate([rate_factor * self._settings[:1], self._settings[1:]])
        loss = learn(
            *(*self._functions, self.theta, self._accumulators, self._counters, settings),
            *(self._samples.feature, self._samples.label, order, self._dropout_mask(len(order)), self._penalty),
        )
        return float(loss)

    def _dropout_mask(self, steps: int) -> Singles:
        retained = self._rng.random((steps, self._hidden), dtype=np.float32) >= self._dropout
        return retained.astype(np.float32) / np.float32(1.0 - self._dropout)


class BatchTrainer:
    """Training by torch with one step per mini-batch, on any device."""

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
        """Current parameters, (size,)."""
        return self._theta.detach().cpu().numpy().copy()

    def run_epoch(self, order: NDArray[np.int64], rate_factor: float) -> float:
        """Train once on the pings in an order."""
        self._optimiser.param_groups[0]["lr"] = rate_factor * self._initial_rate
        rows = torch.from_numpy(order).to(self._device)
        losses = [self._step(part) * len(part) for part in torch.split(rows, self._recipe.batch)]
        return float(torch.stack(losses).sum()) / len(order)

    def _step(self, rows: torch.Tensor) -> torch.Tensor:
        self._optimiser.zero_grad()
        output = self._network.output(self._theta, self._feature[rows], self._dropout_mask(len(rows)))
        loss = torch.mean((output - self._label[rows]) ** 2)
        (loss + self._decay()).backward()
        self._optimiser.step()
        return loss.detach()

    def _decay(self) -> torch.Tensor | float:
        if self._recipe.l1 == self._recipe.l2 == 0.0:
            return 0.0
        return self._penalty[0] @ torch.abs(self._theta) + self._penalty[1] @ self._theta**2

    def _dropout_mask(self, n_pings: int) -> torch.Tensor | None:
        if self._recipe.dropout == 0.0:
            return None
        draw = torch.rand((n_pings, self._network.hidden), generator=self._random, device=self._device)
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
        raise SettingError(f"device {name!r} cannot be used here ({str(error).splitlines()[0]}): try cpu") from None


def fit(
    network: FlatNetwork,
    train: Samples,
    validation: Samples,
    recipe: Recipe,
    rng: np.random.Generator,
    report: Callable[[int], None] = lambda epoch: None,
) -> Fitted:
    """Train a network.

    Args:
        network: architecture.
        train: training pings, shuffled before each epoch.
        validation: pings that select the best parameters.
        recipe: settings.
        rng: random generator of initial parameters, order and dropout.
        report: called after each epoch with its number, counted from 1.

    Raises:
        SettingError: the loss is not finite.
    """
    with flush_denormals():
        engine: Any = OnlineTrainer if recipe.compiled else BatchTrainer
        trainer: Trainer = engine(network, train, recipe, network.initial(rng), rng)
        start, rows, best = time.perf_counter(), list[tuple[float, float, float]](), trainer.theta.copy()
        for epoch in range(recipe.epochs):
            train_loss = trainer.run_epoch(rng.permutation(len(train)), recipe.rate_factor(epoch))
            loss = mean_squared_error(network, trainer.theta, validation)
            if not np.isfinite(loss):
                raise SettingError(f"training diverged in epoch {epoch + 1}: lower the learning rate of {recipe}")
            if loss < min((row[1] for row in rows), default=np.inf):
                best = trainer.theta.copy()
            rows.append((train_loss, loss, time.perf_counter() - start))
            report(epoch + 1)
            if _out_of_patience(recipe, [row[1] for row in rows]):
                break
    return Fitted(best, *np.array(rows).T)


def _out_of_patience(recipe: Recipe, losses: list[float]) -> bool:
    return recipe.patience is not None and len(losses) - 1 - int(np.argmin(losses)) >= recipe.patience


def mean_squared_error(network: FlatNetwork, theta: Singles, samples: Samples) -> float:
    """Return the loss of a network on pings, without dropout."""
    error = network.predict(theta, samples.feature).astype(np.float64) - samples.label
    return float(np.mean(error**2))


@contextmanager
def flush_denormals() -> Iterator[None]:
    """Restrict torch to one thread, and treat numbers below 1e-38 as zero.

    The moments of a parameter with zero gradient decay exponentially. On x86 a multiplication of such denormal numbers
    takes a hundred times longer, which makes Nadam's epochs of an LSTM six times slower.
    """
    torch.set_flush_denormal(True)
    try:
        with one_thread():
            yield
    finally:
        torch.set_flush_denormal(False)
