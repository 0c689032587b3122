"""Networks while they learn: torch twins of what `noise.learned.networks` and `noise.learned.recurrent` run without torch."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from acquisition import EchoStatus, Ping, Reading
from noise.learned.inputs import Inputs
from noise.learned.mixture import FLOOR, UNIT_M, Head
from noise.learned.networks import MlpModel
from noise.learned.recurrent import ANCHORS, LINKS, Before, Cell, LstmModel
from noise.learned.tensors import Layers
from noise.model import IdealModel, steps

LONGEST = 256  # pings of a run that are learned in one go; a longer run is cut
DROP_COVARIATE = 0.25  # of pings or runs are told without their covariates, so that it is learned what holds then


@dataclass(frozen=True)
class Schedule:
    """How a network is trained.

    Attributes:
        epochs: most passes over the training pings.
        patience: passes without a better validation score after which training stops.
        batch: pings a step, or runs where the network remembers.
        learning_rate: of Adam at its highest; it falls to a hundredth along a cosine.
        weight_decay: pull of all weights towards zero.
    """

    epochs: int = 300
    patience: int = 40
    batch: int = 512
    learning_rate: float = 4e-3
    weight_decay: float = 1e-3


@dataclass(frozen=True)
class Batch:
    """Pings as tensors, (..., n) each: all that their likelihood needs.

    Attributes:
        told: what the network is told, (..., n, in): features of the condition, then links to the ping before.
        distance: m.
        low, high: edges of the register's step, m.
        status: an `EchoStatus` each.
        anchors: about which components may lie, m, (..., n, ANCHORS).
        counts: whether the ping is one, or fills a run up.
    """

    told: Tensor
    distance: Tensor
    low: Tensor
    high: Tensor
    status: Tensor
    anchors: Tensor
    counts: Tensor

    @classmethod
    def of(cls, inputs: Inputs, head: Head, ping: Ping, reading: Reading) -> Batch:
        """Convert arrays; edges follow `EchoLaw`: the first and last steps hold all beyond them."""
        law, before = IdealModel(head.resolution, head.max_range).law(ping), Before.each(ping, reading)
        step = law.step(reading.range)
        far = 100.0 * head.max_range  # finite, so that gradients are
        low, high = (np.clip(law.edge(edge), -far, far) for edge in (step - 1, step))
        told = np.concatenate([inputs.features(ping).feature, before.links(ping)], axis=1)
        anchors = before.anchors(ping.distance).T
        return cls(
            _single(told), _single(ping.distance), _single(low), _single(high),
            torch.tensor(reading.status.astype(np.int64)), _single(anchors), torch.ones(len(ping), dtype=torch.bool),
        )  # fmt: skip

    def in_runs(self, run: NDArray[np.int64], longest: int = LONGEST) -> Batch:
        """Return the pings as rows of runs of alike length, (runs, pings, ...), filled up at their ends."""
        place = np.empty(len(run), dtype=np.int64)
        for k, nth in enumerate(steps(run)):
            place[nth] = k
        piece = np.unique(np.stack([run, place // longest]), axis=1, return_inverse=True)[1].ravel()
        index = np.zeros((piece.max() + 1, min(longest, place.max() + 1)), dtype=np.int64)
        counts = np.zeros(index.shape, dtype=bool)
        index[piece, place % longest], counts[piece, place % longest] = np.arange(len(run)), True
        return replace(self[torch.tensor(index)], counts=torch.tensor(counts))

    def __len__(self) -> int:
        return len(self.distance)

    def __getitem__(self, rows: Any) -> Batch:
        return Batch(*(getattr(self, f.name)[rows] for f in fields(self)))


def _single(array: NDArray[np.float64]) -> Tensor:
    return torch.tensor(array, dtype=torch.float32)


def perceptron(widths: list[int]) -> nn.Sequential:
    """Return linear layers with tanh between them."""
    layers: list[nn.Module] = []
    for a, b in pairwise(widths):
        layers += [nn.Linear(a, b), nn.Tanh()]
    return nn.Sequential(*layers[:-1])


def layers_of(network: nn.Sequential) -> Layers:
    """Return the weights and biases of a perceptron."""
    linear = [layer for layer in network if isinstance(layer, nn.Linear)]
    return [(layer.weight.detach().numpy(), layer.bias.detach().numpy()) for layer in linear]


def begin_spread_out(layer: nn.Module, head: Head) -> None:
    """Begin with components from 30 mm short to 300 mm long and along the scale, so that each finds work."""
    assert isinstance(layer, nn.Linear)
    near = np.arcsinh(np.linspace(-0.03, 0.3, head.near) / UNIT_M) if head.near > 1 else np.zeros(1)
    along = (np.arange(head.fixed) + 0.5) / max(head.fixed, 1)
    bias = [*_logits(head), near, np.log(along / (1 - along)), np.zeros(head.anchored)]
    with torch.no_grad():
        layer.weight.mul_(0.3)
        layer.bias.copy_(torch.tensor(np.concatenate([*bias, *_widths(head)])))


def begin_with_nothing(layer: nn.Module, head: Head) -> None:
    """Begin as a correction that corrects nothing, with little weight on what was heard last."""
    assert isinstance(layer, nn.Linear)
    bias = [*_logits(head), np.zeros(head.components), *_widths(head)]
    bias[-3:-1] = [np.zeros(head.near), np.zeros(head.fixed)]
    with torch.no_grad():
        layer.weight.mul_(0.01)
        layer.bias.copy_(torch.tensor(np.concatenate(bias)))


def _logits(head: Head) -> list[NDArray[np.float64]]:
    return [np.zeros(head.near + head.fixed), np.full(head.anchored, -2.0), np.zeros(2), np.full(int(head.fails), -5.0)]


def _widths(head: Head) -> list[NDArray[np.float64]]:
    return [np.zeros(head.near), np.full(head.fixed, 2.5), np.full(head.anchored, -1.0)]


def log_law(head: Head, numbers: Tensor, batch: Batch) -> Tensor:
    """Return the log probability of each ping, nats, (...): the law of `Head.law`, in logarithms."""
    c, n = head.components, head.near
    logit, place, width = numbers[..., : c + 2], numbers[..., -2 * c : -c], numbers[..., -c:]
    log_share = torch.log(FLOOR + (1.0 - FLOOR * (c + 2)) * torch.softmax(logit, dim=-1))
    offset = UNIT_M * torch.sinh(torch.clamp(place, -7.0, 7.0))
    near = batch.distance[..., None] + offset[..., :n]
    fixed = head.max_range * torch.sigmoid(place[..., n : n + head.fixed])
    again = batch.anchors[..., : head.anchored] + offset[..., n + head.fixed :]
    centre = torch.cat([near, fixed, again], dim=-1)
    scale = 0.1 * head.resolution + UNIT_M * torch.exp(torch.clamp(width, -8.0, 6.0))
    peaks = log_share[..., :-2] + _log_between(batch.low[..., None], batch.high[..., None], centre, scale)
    inside = torch.clamp(batch.high, max=head.max_range) - torch.clamp(batch.low, min=0.0)
    even = log_share[..., -2] + torch.log(inside / head.max_range)
    echo = torch.logsumexp(torch.cat([peaks, even[..., None]], dim=-1), dim=-1)
    answered = torch.where(batch.status == EchoStatus.ECHO, echo, log_share[..., -1])
    if not head.fails:
        return answered + math.log1p(-head.no_answer)
    logsigmoid = nn.functional.logsigmoid
    failing = numbers[..., c + 2]
    return torch.where(batch.status == EchoStatus.NO_ANSWER, logsigmoid(failing), answered + logsigmoid(-failing))


def _log_between(low: Tensor, high: Tensor, centre: Tensor, scale: Tensor) -> Tensor:
    """Return the log of a logistic's probability of (low, high]: log s(b) + log s(-a) + log(1 - exp(a - b))."""
    a, b = (low - centre) / scale, (high - centre) / scale
    logsigmoid = nn.functional.logsigmoid
    return logsigmoid(b) + logsigmoid(-a) + torch.log(-torch.expm1(-(high - low) / scale))


class Blind:
    """Takes covariates away from some of the pings or runs while a network learns.

    Args:
        inputs: what the network is told.
    """

    def __init__(self, inputs: Inputs) -> None:
        self.value = [k for k, name in enumerate(inputs.names) if name in inputs.covariates]
        self.known = list(range(inputs.width - len(self.value), inputs.width))

    def __call__(self, told: Tensor) -> Tensor:
        """Return what is told with covariates missing at random, in whole runs."""
        if not self.value:
            return told
        gone = torch.rand(len(told), *[1] * (told.dim() - 1)) < DROP_COVARIATE
        hidden = told.clone()
        hidden[..., self.value], hidden[..., self.known] = 0.0, -1.0
        return torch.where(gone, hidden, told)


class Network(nn.Module):
    """The perceptron while it learns; `noise.learned.networks.MlpModel` is what becomes of it."""

    def __init__(self, inputs: Inputs, head: Head, hidden: int, depth: int) -> None:
        super().__init__()
        self.inputs, self.head, self.blind = inputs, head, Blind(inputs)
        self.layers = perceptron([inputs.width, *[hidden] * depth, head.width])
        begin_spread_out(self.layers[-1], head)

    def numbers(self, told: Tensor) -> Tensor:
        """Return the numbers that the head reads; of what is told, only the condition is looked at."""
        return self.layers(told[..., : self.inputs.width])

    def log_prob(self, batch: Batch) -> Tensor:
        """Return the log probability of each ping that counts, nats, (n,)."""
        told = self.blind(batch.told) if self.training else batch.told
        return log_law(self.head, self.numbers(told), batch)[batch.counts]

    def to_model(self, about: dict[str, Any]) -> MlpModel:
        """Return the trained network in its form without torch."""
        return MlpModel(self.inputs, self.head, layers_of(self.layers), about)


class Memory(nn.Module):
    """The LSTM while it learns, on batches of runs; `noise.learned.recurrent.LstmModel` is what becomes of it.

    Args:
        inputs: what the network is told of a condition.
        head: how its numbers are read.
        state: width of the LSTM's state.
        hidden: width of the layer behind it.
        base: whose numbers are corrected and which learns no more, in the hybrid.
    """

    def __init__(self, inputs: Inputs, head: Head, state: int, hidden: int, base: MlpModel | None = None) -> None:
        super().__init__()
        self.inputs, self.head, self.base, self.blind = inputs, head, base, Blind(inputs)
        told = inputs.width + LINKS
        self.lstm = nn.LSTM(told, state, batch_first=True)
        self.layers = perceptron([told + state, hidden, head.width])
        (begin_spread_out if base is None else begin_with_nothing)(self.layers[-1], head)
        self.fixed = None if base is None else self._frozen(base)
        self.place = None if base is None else torch.tensor(head.places_of(base.head))

    def _frozen(self, base: MlpModel) -> nn.Sequential:
        copy = perceptron(base.sizes)
        linear = [layer for layer in copy if isinstance(layer, nn.Linear)]
        with torch.no_grad():
            for layer, (weight, bias) in zip(linear, base.layers, strict=True):
                layer.weight.copy_(torch.tensor(weight))
                layer.bias.copy_(torch.tensor(bias))
        return copy.requires_grad_(False)

    def numbers(self, told: Tensor) -> Tensor:
        """Return the numbers that the head reads, (runs, pings, width)."""
        numbers = self.layers(torch.cat([told, self.lstm(told)[0]], dim=-1))
        if self.fixed is None or self.place is None:
            return numbers
        return numbers.index_add(-1, self.place, self.fixed(told[..., : self.inputs.width]))

    def log_prob(self, batch: Batch) -> Tensor:
        """Return the log probability of each ping that counts, nats, (n,)."""
        longest = int(batch.counts.sum(dim=1).max())
        batch = batch[:, :longest]
        told = self.blind(batch.told) if self.training else batch.told
        return log_law(self.head, self.numbers(told), batch)[batch.counts]

    def to_model(self, about: dict[str, Any]) -> LstmModel:
        """Return the trained network in its form without torch."""
        weights = {name: value.detach().numpy() for name, value in self.lstm.named_parameters()}
        cell = Cell(weights["weight_ih_l0"], weights["weight_hh_l0"], weights["bias_ih_l0"] + weights["bias_hh_l0"])
        return LstmModel(self.inputs, self.head, cell, layers_of(self.layers), self.base, about)


def with_memory(head: Head) -> Head:
    """Return a head that also places components about what was heard last, and says how likely no answer is."""
    return Head(head.near, head.fixed, head.resolution, head.max_range, anchored=ANCHORS, fails=True)


def fit_network(
    network: Network | Memory, train: Batch, validation: Batch, plan: Schedule, report: Callable[[int, float], None]
) -> tuple[int, float]:
    """Train; leave the best weights in the network; return the pass that gave them and its validation score, nats.

    Args:
        network: to train.
        train: pings to learn from.
        validation: pings by which the best weights are chosen.
        plan: how to train.
        report: called after each pass with its number and the validation score.
    """
    free = [weight for weight in network.parameters() if weight.requires_grad]
    optimiser = torch.optim.AdamW(free, lr=plan.learning_rate, weight_decay=plan.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, plan.epochs, 0.01 * plan.learning_rate)
    best, best_epoch, kept = -math.inf, 0, {k: v.clone() for k, v in network.state_dict().items()}
    for epoch in range(1, plan.epochs + 1):
        network.train()
        for rows in _shuffled(len(train), plan.batch):
            optimiser.zero_grad()
            (-network.log_prob(train[rows]).mean()).backward()
            nn.utils.clip_grad_norm_(free, 5.0)
            optimiser.step()
        schedule.step()
        score = _score(network, validation)
        report(epoch, score)
        if score > best:
            best, best_epoch, kept = score, epoch, {k: v.clone() for k, v in network.state_dict().items()}
        if epoch - best_epoch >= plan.patience:
            break
    network.load_state_dict(kept)
    return best_epoch, best


def _score(network: Network | Memory, validation: Batch) -> float:
    network.eval()
    with torch.no_grad():
        return float(network.log_prob(validation).mean())


def _shuffled(n: int, batch: int) -> Iterator[Tensor]:
    order = torch.randperm(n)
    return (order[start : start + batch] for start in range(0, n, batch))
