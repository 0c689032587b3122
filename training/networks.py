"""Networks while they learn: torch twins of what `noise.networks` runs without torch."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from acquisition import Ping, Reading
from noise.model import IdealModel
from noise.networks import FLOOR, UNIT_M, Head, Inputs, MlpModel


@dataclass(frozen=True)
class Schedule:
    """How a network is trained.

    Attributes:
        epochs: most passes over the training pings.
        patience: passes without a better validation score after which training stops.
        batch: pings a step.
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
    """Answered pings as tensors, (n, ...) each: features, distance, edges of the register's step, echo or silence."""

    feature: Tensor
    distance: Tensor
    low: Tensor
    high: Tensor
    echo: Tensor

    @classmethod
    def of(cls, inputs: Inputs, head: Head, ping: Ping, reading: Reading) -> Batch:
        """Convert arrays; edges follow `EchoLaw`: the first and last steps hold all beyond them."""
        law = IdealModel(head.resolution, head.max_range).law(ping)
        step = law.step(reading.range)
        far = 100.0 * head.max_range  # finite, so that gradients are
        low, high = (np.clip(law.edge(edge), -far, far) for edge in (step - 1, step))
        feature, _ = inputs.features(ping)
        single = [torch.tensor(array, dtype=torch.float32) for array in (feature, ping.distance, low, high)]
        return cls(single[0], single[1], single[2], single[3], torch.tensor(reading.echo))

    def __len__(self) -> int:
        return len(self.distance)

    def __getitem__(self, rows: Tensor) -> Batch:
        return Batch(*(getattr(self, f.name)[rows] for f in fields(self)))


class Network(nn.Sequential):
    """The perceptron while it learns; `noise.networks.MlpModel` is what becomes of it."""

    def __init__(self, inputs: Inputs, head: Head, hidden: int, depth: int) -> None:
        widths = [inputs.width, *[hidden] * depth]
        layers: list[nn.Module] = []
        for a, b in pairwise(widths):
            layers += [nn.Linear(a, b), nn.Tanh()]
        super().__init__(*layers, nn.Linear(widths[-1], head.width))
        self.head = head
        self._begin_spread_out()

    def _begin_spread_out(self) -> None:
        """Begin with components from 30 mm short to 300 mm long and along the scale, so that each finds work."""
        head, last = self.head, self[-1]
        assert isinstance(last, nn.Linear)
        near = np.arcsinh(np.linspace(-0.03, 0.3, head.near) / UNIT_M) if head.near > 1 else np.zeros(1)
        along = (np.arange(head.fixed) + 0.5) / max(head.fixed, 1)
        bias = [np.zeros(head.components + 2), near, np.log(along / (1 - along)), np.full(head.near, 0.0)]
        with torch.no_grad():
            last.weight.mul_(0.3)
            last.bias.copy_(torch.tensor(np.concatenate([*bias, np.full(head.fixed, 2.5)])))

    def log_prob(self, batch: Batch) -> Tensor:
        """Return the log probability of each answered ping, nats, (n,): the law of `Head.law`, in logarithms."""
        head = self.head
        logit, place, width = torch.split(
            self(batch.feature), [head.components + 2, head.components, head.components], dim=1
        )
        log_share = torch.log(FLOOR + (1.0 - FLOOR * logit.shape[1]) * torch.softmax(logit, dim=1))
        near = batch.distance[:, None] + UNIT_M * torch.sinh(torch.clamp(place[:, : head.near], -7.0, 7.0))
        centre = torch.cat([near, head.max_range * torch.sigmoid(place[:, head.near :])], dim=1)
        scale = 0.1 * head.resolution + UNIT_M * torch.exp(torch.clamp(width, -8.0, 6.0))
        peaks = log_share[:, :-2] + _log_between(batch.low[:, None], batch.high[:, None], centre, scale)
        inside = torch.clamp(batch.high, max=head.max_range) - torch.clamp(batch.low, min=0.0)
        even = log_share[:, -2] + torch.log(inside / head.max_range)
        echo = torch.logsumexp(torch.cat([peaks, even[:, None]], dim=1), dim=1)
        return torch.where(batch.echo, echo, log_share[:, -1]) + math.log1p(-head.no_answer)

    def to_model(self, inputs: Inputs, about: dict[str, Any]) -> MlpModel:
        """Return the trained network in its form without torch."""
        linear = [layer for layer in self if isinstance(layer, nn.Linear)]
        layers = [(layer.weight.detach().numpy(), layer.bias.detach().numpy()) for layer in linear]
        return MlpModel(inputs, self.head, layers, about)


def _log_between(low: Tensor, high: Tensor, centre: Tensor, scale: Tensor) -> Tensor:
    """Return the log of a logistic's probability of (low, high]: log s(b) + log s(-a) + log(1 - exp(a - b))."""
    a, b = (low - centre) / scale, (high - centre) / scale
    logsigmoid = nn.functional.logsigmoid
    return logsigmoid(b) + logsigmoid(-a) + torch.log(-torch.expm1(-(high - low) / scale))


def fit_network(
    network: Network, train: Batch, validation: Batch, plan: Schedule, report: Callable[[int, float], None]
) -> tuple[int, float]:
    """Train; leave the best weights in the network; return the pass that gave them and its validation score, nats.

    Args:
        network: to train.
        train: pings to learn from.
        validation: pings by which the best weights are chosen.
        plan: how to train.
        report: called after each pass with its number and the validation score.
    """
    optimiser = torch.optim.AdamW(network.parameters(), lr=plan.learning_rate, weight_decay=plan.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, plan.epochs, 0.01 * plan.learning_rate)
    best, best_epoch, kept = -math.inf, 0, {k: v.clone() for k, v in network.state_dict().items()}
    for epoch in range(1, plan.epochs + 1):
        for rows in _shuffled(len(train), plan.batch):
            optimiser.zero_grad()
            (-network.log_prob(train[rows]).mean()).backward()
            nn.utils.clip_grad_norm_(network.parameters(), 5.0)
            optimiser.step()
        schedule.step()
        with torch.no_grad():
            score = float(network.log_prob(validation).mean())
        report(epoch, score)
        if score > best:
            best, best_epoch, kept = score, epoch, {k: v.clone() for k, v in network.state_dict().items()}
        if epoch - best_epoch >= plan.patience:
            break
    network.load_state_dict(kept)
    return best_epoch, best


def _shuffled(n: int, batch: int) -> Iterator[Tensor]:
    order = torch.randperm(n)
    return (order[start : start + batch] for start in range(0, n, batch))
