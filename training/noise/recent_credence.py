"""Learning credence given the last readings, and scoring it beside credence given one reading alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from acquisition import Ping, Reading, Recording
from noise.fitting.threads import one_thread
from noise.law import CREDENCE_TOLERANCE, Floats
from noise.learned.recent import EACH, Recent, RecentCredence
from noise.metrics import Reliability, Score, reliability
from training.noise.networks import layers_of, perceptron

LEAST = 1e-6  # what is said is never taken for certain


@dataclass(frozen=True)
class Plan:
    """How it is learned.

    Attributes:
        depth: readings looked at.
        hidden: width of the one hidden layer.
        epochs: passes over the training readings.
        batch: readings a step.
        learning_rate: of Adam at its highest; it falls along a cosine.
        seed: of the first weights and the order.
    """

    depth: int = 8
    hidden: int = 48
    epochs: int = 25
    batch: int = 1024
    learning_rate: float = 4e-3
    seed: int = 0


def right(ping: Ping, reading: Reading, tolerance: float = CREDENCE_TOLERANCE) -> NDArray[np.bool_]:
    """Return which readings are echoes within a tolerance of the true distance, (n,)."""
    return reading.echo & (np.abs(reading.range - ping.distance) <= tolerance * ping.distance + 1e-9)


def learn_credence(train: Recording, validation: Recording, plan: Plan) -> RecentCredence:
    """Learn from every echo of a recording, keeping the weights that are best on another."""
    (x, y), (xv, yv) = (_tensors(recording, plan.depth) for recording in (train, validation))
    with torch.random.fork_rng(), one_thread():
        torch.manual_seed(plan.seed)
        network = perceptron([plan.depth * EACH, plan.hidden, 1])
        optimiser = torch.optim.AdamW(network.parameters(), lr=plan.learning_rate, weight_decay=1e-3)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, plan.epochs, 0.01 * plan.learning_rate)
        loss, best, kept = nn.BCEWithLogitsLoss(), np.inf, network.state_dict()
        for _ in range(plan.epochs):
            for rows in torch.randperm(len(y)).split(plan.batch):
                optimiser.zero_grad()
                loss(network(x[rows])[:, 0], y[rows]).backward()
                optimiser.step()
            schedule.step()
            with torch.no_grad():
                score = float(loss(network(xv)[:, 0], yv))
            if score < best:
                best, kept = score, {name: value.clone() for name, value in network.state_dict().items()}
        network.load_state_dict(kept)
    return RecentCredence(plan.depth, layers_of(network), {"seed": plan.seed, "validation_log_score": best})


def _tensors(recording: Recording, depth: int) -> tuple[Tensor, Tensor]:
    ping, reading = recording.ping, recording.reading
    rows = reading.echo
    feature = Recent.each(depth, ping, reading).features()[rows]
    return torch.tensor(feature, dtype=torch.float32), torch.tensor(right(ping, reading)[rows], dtype=torch.float32)


@dataclass(frozen=True)
class CredenceScore:
    """How good credence is that was said of n readings.

    Attributes:
        log_score: mean log probability of what came true, nats; 0 at best.
        brier: mean square of what was missed; 0 at best.
        reliability: what was said and what came true.
    """

    log_score: Score
    brier: Score
    reliability: Reliability

    @classmethod
    def of(cls, said: Floats, true: NDArray[np.bool_], cluster: NDArray[np.int64]) -> CredenceScore:
        """Score what was said of n readings, (n,), which share clusters."""
        sure = np.clip(said, LEAST, 1.0 - LEAST)
        log = np.where(true, np.log(sure), np.log1p(-sure))
        return cls(Score.of(log, cluster), Score.of((said - true) ** 2, cluster), reliability(said, true, cluster))
