"""Experiments on memory: the gain of an LSTM on correlated pings, and credence learned from recent readings.

Gain: in each scenario one nominal sensor is recorded on the rig, every visit in another condition. A perceptron and a
hybrid on top of it are trained on the same sessions; the gain is the difference of their log-likelihoods on others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from acquisition import Ping, Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.laboratory.setup import Bus
from noise.fitting.threads import one_thread
from noise.law import Floats
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.learned.recent import N_FEATURES, RecentCredence, RecentReadings
from noise.metrics import ClusterMean, Reliability, is_correct, reliability
from noise.model import MAX_RANGE, follow
from noise.store import save_model
from training.noise.networks import layers_of, perceptron
from training.noise.train import Args, TrainingPings, learn

STEP_S, STEP_M = 0.2, 0.01  # between pings; of the register
MIN_PROBABILITY = 1e-6  # bound of credence in the log score
INPUTS = ("distance", "angle", "incidence", "reflectance")


@dataclass(frozen=True)
class MemoryScenario:
    """How the sessions of a scenario are recorded.

    Attributes:
        setup: the laboratory.
        cold_s: excess of the sensor's measured times at power-on, s.
        latest_s: latest start of a session after power-on, s.
        pings_per_visit: number of pings per condition.
        drawn_units: whether each session has a different sensor.
    """

    setup: Setup = field(default_factory=lambda: Setup(gain=31, drift_c=0.0))
    cold_s: float = 0.0
    latest_s: float = 0.0
    pings_per_visit: int = 1
    drawn_units: bool = False


NO_DRIFT = Setup(gain=31, drift_c=0.0)
SCENARIOS: Mapping[str, MemoryScenario] = {
    "independent pings": MemoryScenario(),
    "loose wire": MemoryScenario(replace(NO_DRIFT, bus=Bus(nack=0.1, lost_write=0.15, dwell_s=1.0))),
    "drift: a sensor that warms up": MemoryScenario(cold_s=300e-6, latest_s=1800.0),
    "another sensor each session": MemoryScenario(drawn_units=True),
    "visits of 8 pings": MemoryScenario(pings_per_visit=8),
}
UNCORRELATED, CORRELATED = ("independent pings",), ("loose wire", "drift: a sensor that warms up")


@dataclass(frozen=True)
class MemoryExperiment:
    """Size of the experiment.

    Attributes:
        sessions: number of training sessions; half as many for validation, as many again for testing.
        pings: number of pings per session.
        epochs: number of training epochs of each network.
        seed: of all random draws.
    """

    sessions: int = 40
    pings: int = 64
    epochs: int = 60
    seed: int = 0


def record_scenario(scenario: MemoryScenario, sessions: int, pings: int, rng: np.random.Generator) -> Recording:
    """Record sessions of a scenario on the rig."""
    return Recording(
        pd.concat([_session(scenario, k, pings, rng) for k in range(sessions)], ignore_index=True), "world"
    )


def _session(scenario: MemoryScenario, number: int, pings: int, rng: np.random.Generator) -> pd.DataFrame:
    unit = Unit.draw(int(rng.integers(1, 10_000))) if scenario.drawn_units else Unit.nominal()
    unit = replace(unit, cold_s=scenario.cold_s)
    visits = pings // scenario.pings_per_visit
    distance, bearing = rng.uniform(0.2, 4.0, visits), np.deg2rad(rng.uniform(0.0, 12.0, visits))
    reflectance = rng.choice([0.1, 0.9], visits)
    time = rng.uniform(0.0, scenario.latest_s) + STEP_S * np.arange(visits * scenario.pings_per_visit)
    each = [np.repeat(value, scenario.pings_per_visit) for value in (distance, bearing, reflectance)]
    ping = Ping.of(each[0], each[1], reflectance=each[2], time=time)
    return Rig(unit, scenario.setup).record(ping, rng).table.assign(session=str(number))


@dataclass(frozen=True)
class MemoryGain:
    """Log-likelihood on the test sessions, nats per ping, with standard errors over sessions.

    Attributes:
        without: of the perceptron.
        gain: of the hybrid over the perceptron.
    """

    without: ClusterMean
    gain: ClusterMean


def measure(scenario: MemoryScenario, experiment: MemoryExperiment) -> MemoryGain:
    """Record a scenario, train with and without memory, and compare."""
    rng = np.random.default_rng([experiment.seed, 0x6A1])
    counts = (experiment.sessions, experiment.sessions // 2, experiment.sessions)
    train, choose, test = (record_scenario(scenario, count, experiment.pings, rng) for count in counts)
    inputs = Inputs.of(train.ping, INPUTS)
    head = Head(4, 1, STEP_M, MAX_RANGE, no_answer=float(1.0 - train.reading.answered.mean()))
    with TemporaryDirectory() as folder:
        epochs, seed = experiment.epochs, experiment.seed
        args = Args(Path(), Path(folder) / "mlp", hidden=32, epochs=epochs, patience=epochs, seed=seed)
        base = learn(_pings(train, True), _pings(choose, True), inputs, head, args)
        args = replace(args, law="hybrid", base=str(save_model(base, args.out)), state=24, batch=8 * 32)
        hybrid = learn(_pings(train), _pings(choose), inputs, head, args)
    without, with_memory = (follow(model, test.ping, test.reading).log_prob(test.reading) for model in (base, hybrid))
    return MemoryGain(ClusterMean.of(without, test.run), ClusterMean.of(with_memory - without, test.run))


def _pings(recording: Recording, answered: bool = False) -> TrainingPings:
    """Return all pings, or only the answered ones."""
    rows = recording.reading.answered | (not answered)
    return TrainingPings.of(recording, rows, recording.run)


@dataclass(frozen=True)
class RecentCredencePlan:
    """Settings of the training.

    Attributes:
        depth: number of recent readings.
        hidden: width of the hidden layer.
        epochs: number of passes over the training readings.
        batch: readings per step.
        learning_rate: initial rate of AdamW, annealed along a cosine.
        seed: of the initial weights and the order of readings.
    """

    depth: int = 8
    hidden: int = 48
    epochs: int = 25
    batch: int = 1024
    learning_rate: float = 4e-3
    seed: int = 0


def learn_credence(train: Recording, validation: Recording, plan: RecentCredencePlan) -> RecentCredence:
    """Train on every echo of a recording and return the weights with the best validation loss."""
    (x, y), (xv, yv) = (_tensors(recording, plan.depth) for recording in (train, validation))
    with torch.random.fork_rng(), one_thread():
        torch.manual_seed(plan.seed)
        network = perceptron([plan.depth * N_FEATURES, plan.hidden, 1])
        optimiser = torch.optim.AdamW(network.parameters(), lr=plan.learning_rate, weight_decay=1e-3)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, plan.epochs, 0.01 * plan.learning_rate)
        loss, best, best_weights = nn.BCEWithLogitsLoss(), np.inf, network.state_dict()
        for _ in range(plan.epochs):
            for rows in torch.randperm(len(y)).split(plan.batch):
                optimiser.zero_grad()
                loss(network(x[rows])[:, 0], y[rows]).backward()
                optimiser.step()
            schedule.step()
            with torch.no_grad():
                score = float(loss(network(xv)[:, 0], yv))
            if score < best:
                best, best_weights = score, {name: value.clone() for name, value in network.state_dict().items()}
        network.load_state_dict(best_weights)
    return RecentCredence(plan.depth, layers_of(network), {"seed": plan.seed, "validation_log_score": best})


def _tensors(recording: Recording, depth: int) -> tuple[Tensor, Tensor]:
    ping, reading = recording.ping, recording.reading
    rows = reading.echo
    feature = RecentReadings.of_recording(depth, ping, reading).features()[rows]
    return torch.tensor(feature, dtype=torch.float32), torch.tensor(
        is_correct(ping, reading)[rows], dtype=torch.float32
    )


@dataclass(frozen=True)
class CredenceScore:
    """Proper scores and reliability of the credence of n readings.

    Attributes:
        log_score: mean log probability of the outcome, nats; 0 is perfect.
        brier: mean squared error; 0 is perfect.
        reliability: predicted against observed frequency.
    """

    log_score: ClusterMean
    brier: ClusterMean
    reliability: Reliability

    @classmethod
    def of(cls, credence: Floats, correct: NDArray[np.bool_], cluster: NDArray[np.int64]) -> CredenceScore:
        """Score the credence of n readings, (n,), with standard errors over clusters."""
        clipped = np.clip(credence, MIN_PROBABILITY, 1.0 - MIN_PROBABILITY)
        log = np.where(correct, np.log(clipped), np.log1p(-clipped))
        return cls(
            ClusterMean.of(log, cluster),
            ClusterMean.of((credence - correct) ** 2, cluster),
            reliability(credence, correct, cluster),
        )
