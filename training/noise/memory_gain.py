"""What memory is worth where pings depend on each other, and that it is worth nothing where they do not.

In each world one nominal sensor is recorded on the rig, every ping in another condition; a perceptron and a hybrid on
top of it learn from half of the sessions, and the difference of their likelihoods on the others is the gain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from acquisition import Ping, Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.setup import Bus
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.metrics import Score
from noise.model import MAX_RANGE, follow
from noise.store import save_model
from training.noise.train import Args, Pings, learn

STEP_S, STEP_M = 0.2, 0.01
NAMES = ("distance", "angle", "incidence", "reflectance")


@dataclass(frozen=True)
class World:
    """What a session of a world is.

    Attributes:
        setup: the laboratory.
        cold_s: by how much the sensor's times run long when it is switched on, s.
        latest_s: sessions begin up to so long after that.
        stay: pings for which each reflector stays.
        units: whether every session has a sensor of its own.
    """

    setup: Setup = field(default_factory=lambda: Setup(gain=31, drift_c=0.0))
    cold_s: float = 0.0
    latest_s: float = 0.0
    stay: int = 1
    units: bool = False


STEADY = Setup(gain=31, drift_c=0.0)
WORLDS: Mapping[str, World] = {
    "nothing to remember": World(),
    "loose wire": World(replace(STEADY, bus=Bus(nack=0.1, lost_write=0.15, dwell_s=1.0))),
    "drift: a sensor that warms up": World(cold_s=300e-6, latest_s=1800.0),
    "another sensor each session": World(units=True),
    "reflectors that stay for 8 pings": World(stay=8),
}

UNCORRELATED, CORRELATED = ("nothing to remember",), ("loose wire", "drift: a sensor that warms up")


@dataclass(frozen=True)
class Plan:
    """How much is recorded and learned.

    Attributes:
        sessions: to learn from; half as many choose the weights, and as many again are scored.
        pings: a session.
        epochs: of training each network.
        seed: of everything.
    """

    sessions: int = 40
    pings: int = 64
    epochs: int = 60
    seed: int = 0


def record_world(world: World, sessions: int, pings: int, rng: np.random.Generator) -> Recording:
    """Record sessions of a world on the rig."""
    return Recording(pd.concat([_session(world, k, pings, rng) for k in range(sessions)], ignore_index=True), "world")


def _session(world: World, number: int, pings: int, rng: np.random.Generator) -> pd.DataFrame:
    unit = Unit.draw(int(rng.integers(1, 10_000))) if world.units else Unit.nominal()
    unit = replace(unit, cold_s=world.cold_s)
    visits = pings // world.stay
    distance, bearing = rng.uniform(0.2, 4.0, visits), np.deg2rad(rng.uniform(0.0, 12.0, visits))
    reflectance = rng.choice([0.1, 0.9], visits)
    time = rng.uniform(0.0, world.latest_s) + STEP_S * np.arange(visits * world.stay)
    each = [np.repeat(value, world.stay) for value in (distance, bearing, reflectance)]
    ping = Ping.of(each[0], each[1], reflectance=each[2], time=time)
    return Rig(unit, world.setup).record(ping, rng).table.assign(session=str(number))


@dataclass(frozen=True)
class Gain:
    """Likelihood of the sessions scored, nats a ping, standard errors over sessions.

    Attributes:
        without: of the perceptron.
        gain: by which the hybrid is better.
    """

    without: Score
    gain: Score


def measure(world: World, plan: Plan) -> Gain:
    """Record a world, learn it with and without memory, and compare."""
    rng = np.random.default_rng([plan.seed, 0x6A1])
    counts = (plan.sessions, plan.sessions // 2, plan.sessions)
    train, choose, test = (record_world(world, count, plan.pings, rng) for count in counts)
    inputs = Inputs.of(train.ping, NAMES)
    head = Head(4, 1, STEP_M, MAX_RANGE, no_answer=float(1.0 - train.reading.answered.mean()))
    with TemporaryDirectory() as folder:
        args = Args(Path(), Path(folder) / "mlp", hidden=32, epochs=plan.epochs, patience=plan.epochs, seed=plan.seed)
        base = learn(_pings(train, True), _pings(choose, True), inputs, head, args)
        args = replace(args, law="hybrid", base=str(save_model(base, args.out)), state=24, batch=8 * 32)
        hybrid = learn(_pings(train), _pings(choose), inputs, head, args)
    without, with_memory = (follow(model, test.ping, test.reading).log_prob(test.reading) for model in (base, hybrid))
    return Gain(Score.of(without, test.run), Score.of(with_memory - without, test.run))


def _pings(recording: Recording, answered: bool = False) -> Pings:
    """Return all pings, or those with an answer."""
    rows = recording.reading.answered | (not answered)
    return Pings.of(recording, rows, recording.run)
