"""Networks in torch for training; `noise.learned.networks` and `noise.learned.recurrent` run them in numpy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from acquisition import EchoStatus, Ping, Reading
from noise.learned.gain import LOSS
from noise.learned.inputs import Inputs
from noise.learned.mixture import FLOOR, UNIT_M, Head
from noise.learned.networks import MlpModel
from noise.learned.recurrent import LstmModel
from noise.learned.recurrent_state import N_ANCHORS, N_HISTORY_FEATURES, LstmCell, PingHistory
from noise.learned.tensors import Layers
from noise.model import IdealModel, steps
from training.noise.restarts import draw_restarts, echo_known, padded_sequences, whole_runs, without_past

MAX_RUN_PINGS = 256  # length at which training runs are cut
COVARIATE_DROPOUT = 0.25  # probability that the covariates of a ping or run are masked


@dataclass(frozen=True)
class Schedule:
    """Settings of the optimisation.

    Attributes:
        epochs: largest number of passes over the training pings.
        patience: number of passes without a better validation score after which training stops.
        batch: pings per step, or runs for a recurrent network.
        learning_rate: initial rate of AdamW, annealed to a hundredth along a cosine.
        weight_decay: of AdamW.
    """

    epochs: int = 300
    patience: int = 40
    batch: int = 512
    learning_rate: float = 4e-3
    weight_decay: float = 1e-3


@dataclass(frozen=True)
class TrainingBatch:
    """Pings as tensors, (..., n) each, with all that their likelihood requires.

    Attributes:
        features: inputs of the network, (..., n, in): features of the condition, then links to the previous ping.
        distance: m.
        low, high: bounds of the register's step, m.
        status: an `EchoStatus` each.
        anchors: previous readings about which components may be centred, m, (..., n, N_ANCHORS).
        valid: False for padding.
    """

    features: Tensor
    distance: Tensor
    low: Tensor
    high: Tensor
    status: Tensor
    anchors: Tensor
    valid: Tensor

    @classmethod
    def of(cls, inputs: Inputs, head: Head, ping: Ping, reading: Reading) -> TrainingBatch:
        """Convert arrays; bounds follow `EchoLaw`: the first and last steps include everything beyond them."""
        ping = inputs.equivalent(ping)
        law, before = IdealModel(head.resolution, head.max_range).law(ping), PingHistory.of_recording(ping, reading)
        step = law.step(reading.range)
        far = 100.0 * head.max_range  # finite, for finite gradients
        low, high = (np.clip(law.edge(edge), -far, far) for edge in (step - 1, step))
        features = np.concatenate([inputs.features(ping).feature, before.features(ping)], axis=1)
        anchors = before.anchors(ping.distance).T
        return cls(
            _single(features), _single(ping.distance), _single(low), _single(high),
            torch.tensor(reading.status.astype(np.int64)), _single(anchors), torch.ones(len(ping), dtype=torch.bool),
        )  # fmt: skip

    def in_runs(self, run: NDArray[np.int64], max_pings: int = MAX_RUN_PINGS) -> TrainingBatch:
        """Return the pings as rows of runs, (runs, pings, ...), padded at their ends; longer runs are cut."""
        place = np.empty(len(run), dtype=np.int64)
        for k, nth in enumerate(steps(run)):
            place[nth] = k
        piece = np.unique(np.stack([run, place // max_pings]), axis=1, return_inverse=True)[1].ravel()
        index = np.zeros((piece.max() + 1, min(max_pings, place.max() + 1)), dtype=np.int64)
        valid = np.zeros(index.shape, dtype=bool)
        index[piece, place % max_pings], valid[piece, place % max_pings] = np.arange(len(run)), True
        return replace(self[torch.tensor(index)], valid=torch.tensor(valid))

    def restarted(self, begins: Tensor) -> TrainingBatch:
        """Return runs in which nothing is known of the pings before the beginning of a sequence, (runs, pings)."""
        known = torch.stack([echo_known(self.features, begins), ~begins], dim=-1)
        anchors = torch.where(known, self.anchors, self.distance[..., None])
        return replace(self, features=without_past(self.features, begins), anchors=anchors)

    def __len__(self) -> int:
        return len(self.distance)

    def __getitem__(self, rows: Any) -> TrainingBatch:
        return TrainingBatch(*(getattr(self, f.name)[rows] for f in fields(self)))


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


def set_layers(network: nn.Sequential, layers: Layers) -> None:
    """Set the weights and biases of a perceptron of the same widths."""
    linear = [layer for layer in network if isinstance(layer, nn.Linear)]
    with torch.no_grad():
        for layer, (weight, bias) in zip(linear, layers, strict=True):
            layer.weight.copy_(torch.tensor(weight))
            layer.bias.copy_(torch.tensor(bias))


def init_spread(layer: nn.Module, head: Head) -> None:
    """Initialise components from 30 mm short to 300 mm long and along the scale."""
    assert isinstance(layer, nn.Linear)
    near = np.arcsinh(np.linspace(-0.03, 0.3, head.near) / UNIT_M) if head.near > 1 else np.zeros(1)
    along = (np.arange(head.fixed) + 0.5) / max(head.fixed, 1)
    bias = [*_logits(head), near, np.log(along / (1 - along)), np.zeros(head.anchored)]
    with torch.no_grad():
        layer.weight.mul_(0.3)
        layer.bias.copy_(torch.tensor(np.concatenate([*bias, *_widths(head)])))


def init_zero_correction(layer: nn.Module, head: Head) -> None:
    """Initialise a correction near zero, with little weight on the previous readings."""
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


def log_likelihood(head: Head, numbers: Tensor, batch: TrainingBatch) -> Tensor:
    """Return the log probability of each ping, nats, (...): the law of `Head.law` in logarithms."""
    c, n = head.components, head.near
    logit, place, width = numbers[..., : c + 2], numbers[..., -2 * c : -c], numbers[..., -c:]
    log_share = torch.log(FLOOR + (1.0 - FLOOR * (c + 2)) * torch.softmax(logit, dim=-1))
    offset = UNIT_M * torch.sinh(torch.clamp(place, -7.0, 7.0))
    near = batch.distance[..., None] + offset[..., :n]
    fixed = head.max_range * torch.sigmoid(place[..., n : n + head.fixed])
    anchored = batch.anchors[..., : head.anchored] + offset[..., n + head.fixed :]
    centre = torch.cat([near, fixed, anchored], dim=-1)
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


class CovariateDropout:
    """Masks the covariates of random pings or runs during training, so that the law without them is learned too.

    Args:
        inputs: inputs of the network.
    """

    def __init__(self, inputs: Inputs) -> None:
        first = inputs.width - len(inputs.covariates)
        masked = [(k, name) for k, name in enumerate(inputs.covariates) if name != LOSS]  # which is never missing
        self.value = [inputs.names.index(name) for _, name in masked]
        self.known = [first + k for k, _ in masked]

    def __call__(self, features: Tensor) -> Tensor:
        """Return the features with covariates masked at random, in whole runs."""
        if not self.value:
            return features
        dropped = torch.rand(len(features), *[1] * (features.dim() - 1)) < COVARIATE_DROPOUT
        hidden = features.clone()
        hidden[..., self.value], hidden[..., self.known] = 0.0, -1.0
        return torch.where(dropped, hidden, features)


class MixtureNetwork(nn.Module):
    """Perceptron in torch; `to_model` converts it to `noise.learned.networks.MlpModel`.

    Args:
        inputs: features of a condition.
        head: interpretation of the network's output.
        hidden: width of each hidden layer.
        depth: number of hidden layers.
        start: perceptron with whose weights training begins, of the same inputs and components; its widths are used.
    """

    def __init__(self, inputs: Inputs, head: Head, hidden: int, depth: int, start: MlpModel | None = None) -> None:
        super().__init__()
        self.inputs, self.head, self.dropout = inputs, head, CovariateDropout(inputs)
        sizes = [inputs.width, *[hidden] * depth, head.width] if start is None else start.sizes
        self.layers = perceptron(sizes)
        if start is None:
            init_spread(self.layers[-1], head)
        else:
            set_layers(self.layers, start.layers)

    def numbers(self, features: Tensor) -> Tensor:
        """Return the inputs of the head; only the features of the condition are used."""
        return self.layers(features[..., : self.inputs.width])

    def log_prob(self, batch: TrainingBatch) -> Tensor:
        """Return the log probability of each valid ping, nats, (n,)."""
        features = self.dropout(batch.features) if self.training else batch.features
        return log_likelihood(self.head, self.numbers(features), batch)[batch.valid]

    def to_model(self, about: dict[str, Any]) -> MlpModel:
        """Return the trained network in its numpy form."""
        return MlpModel(self.inputs, self.head, layers_of(self.layers), about)


class LstmNetwork(nn.Module):
    """LSTM in torch, on batches of runs; `to_model` converts it to `noise.learned.recurrent.LstmModel`.

    Args:
        inputs: features of a condition.
        head: interpretation of the network's output.
        state: width of the LSTM's state.
        hidden: width of the layer after the LSTM.
        base: fixed perceptron whose output the hybrid corrects.
    """

    def __init__(self, inputs: Inputs, head: Head, state: int, hidden: int, base: MlpModel | None = None) -> None:
        super().__init__()
        self.inputs, self.head, self.base, self.dropout = inputs, head, base, CovariateDropout(inputs)
        features = inputs.width + N_HISTORY_FEATURES
        self.lstm = nn.LSTM(features, state, batch_first=True)
        self.layers = perceptron([features + state, hidden, head.width])
        (init_spread if base is None else init_zero_correction)(self.layers[-1], head)
        self.fixed = None if base is None else self._frozen_copy(base)
        self.place = None if base is None else torch.tensor(head.indices_of(base.head))

    def _frozen_copy(self, base: MlpModel) -> nn.Sequential:
        copy = perceptron(base.sizes)
        set_layers(copy, base.layers)
        return copy.requires_grad_(False)

    def numbers(self, features: Tensor, sequences: Iterable[tuple[Tensor, Tensor]]) -> Tensor:
        """Return the inputs of the head, (n, width), of pings in sequences; see `padded_sequences`."""
        states, places = [], []
        for index, padding in sequences:
            states.append(self.lstm(features[index])[0][~padding])
            places.append(index[~padding])
        hidden = torch.cat(states)[torch.argsort(torch.cat(places))]
        numbers = self.layers(torch.cat([features, hidden], dim=-1))
        if self.fixed is None or self.place is None:
            return numbers
        return numbers.index_add(-1, self.place, self.fixed(features[..., : self.inputs.width]))

    def log_prob(self, batch: TrainingBatch, begins: Tensor | None = None) -> Tensor:
        """Return the log probability of each valid ping, nats, (n,).

        Args:
            batch: runs of pings.
            begins: where a memory begins, (runs, pings); by default with each run, and in training also elsewhere.
        """
        if begins is None:
            begins = draw_restarts(batch.features, batch.valid) if self.training else whole_runs(batch.valid)
        batch = batch.restarted(begins)
        features = self.dropout(batch.features) if self.training else batch.features
        pings = replace(batch, features=features)[batch.valid]
        return log_likelihood(self.head, self.numbers(pings.features, padded_sequences(begins, batch.valid)), pings)

    def to_model(self, about: dict[str, Any]) -> LstmModel:
        """Return the trained network in its numpy form."""
        weights = {name: value.detach().numpy() for name, value in self.lstm.named_parameters()}
        cell = LstmCell(weights["weight_ih_l0"], weights["weight_hh_l0"], weights["bias_ih_l0"] + weights["bias_hh_l0"])
        return LstmModel(self.inputs, self.head, cell, layers_of(self.layers), self.base, about)


def recurrent_head(head: Head) -> Head:
    """Return a head with components about previous readings and a probability of no answer."""
    return Head(head.near, head.fixed, head.resolution, head.max_range, anchored=N_ANCHORS, fails=True)


def fit_network(
    network: MixtureNetwork | LstmNetwork,
    train: TrainingBatch,
    validation: TrainingBatch,
    settings: Schedule,
    report: Callable[[int, float], None],
) -> tuple[int, float]:
    """Train, restore the best weights, and return their epoch and validation score, nats.

    Args:
        network: to train.
        train: training pings.
        validation: pings on which the best weights are chosen.
        settings: of the optimisation.
        report: called after each epoch with its number and the validation score.
    """
    free = [weight for weight in network.parameters() if weight.requires_grad]
    optimiser = torch.optim.AdamW(free, lr=settings.learning_rate, weight_decay=settings.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.epochs, 0.01 * settings.learning_rate)
    best, best_epoch, best_weights = -math.inf, 0, {k: v.clone() for k, v in network.state_dict().items()}
    for epoch in range(1, settings.epochs + 1):
        network.train()
        for rows in _shuffled(len(train), settings.batch):
            optimiser.zero_grad()
            (-network.log_prob(train[rows]).mean()).backward()
            nn.utils.clip_grad_norm_(free, 5.0)
            optimiser.step()
        schedule.step()
        score = _score(network, validation)
        report(epoch, score)
        if score > best:
            best, best_epoch, best_weights = score, epoch, {k: v.clone() for k, v in network.state_dict().items()}
        if epoch - best_epoch >= settings.patience:
            break
    network.load_state_dict(best_weights)
    return best_epoch, best


def _score(network: MixtureNetwork | LstmNetwork, validation: TrainingBatch) -> float:
    """Return the mean log probability of validation pings, nats; of a recurrent network also with a memory cut."""
    network.eval()
    with torch.no_grad():
        score = float(network.log_prob(validation).mean())
        if isinstance(network, LstmNetwork):
            cut = draw_restarts(validation.features, validation.valid, torch.Generator().manual_seed(0))
            score = 0.5 * (score + float(network.log_prob(validation, cut).mean()))
    return score


def _shuffled(n: int, batch: int) -> Iterator[Tensor]:
    order = torch.randperm(n)
    return (order[start : start + batch] for start in range(0, n, batch))
