"""How fast laws are drawn on one core: for a car's eight sonars, and for 1,024 cars at once.

Each number is processor time, the best of several repetitions, since whatever else the machine does only adds to it.
"""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from acquisition import Ping, Reading
from noise import CredenceTable, GaussianModel, IdealModel, SonarModel, listener
from noise.faults import Faulty, Noise, Short
from noise.fitting.threads import one_thread
from noise.learned.networks import MlpModel
from noise.learned.recent import Recent, RecentCredence
from training.noise.draw_paths import PATHS, Draw, disagreement

FEW, MANY = 8, 8 * 1024  # pings
LIMITS = {FEW: 100e-6, MANY: 15e-3}  # s
REPEATS = {FEW: (200, 20), MANY: (8, 1)}  # how often, and draws each time
DRAWS = 20_000  # of each condition, by which a path is compared with the law


@dataclass(frozen=True)
class Speed:
    """How long a draw takes, and how true it is.

    Attributes:
        seconds: processor time by number of pings.
        off: mean distance in total variation of what is drawn from the law; None where that was not measured.
    """

    seconds: Mapping[int, float]
    off: float | None = None


def pings(n: int) -> Ping:
    """Return n conditions as a simulator meets them: no thermometer."""
    rng = np.random.default_rng(0)
    return Ping.of(rng.uniform(0.1, 5.0, n), rng.uniform(0.0, 0.5, n), reflectance=rng.uniform(0.1, 1.0, n))


def seconds(draw: Callable[[], object], n: int) -> float:
    """Return the processor time of a draw of n pings."""
    repeats, number = REPEATS[n]
    draw()
    return min(timeit.Timer(draw, timer=time.process_time).repeat(repeats, number)) / number


def stepper(model: SonarModel, ping: Ping) -> Callable[[], Reading]:
    """Return a function that draws one reading more of every sensor, each given the last where the model remembers."""
    own, rng, past = listener(model), np.random.default_rng(0), None

    def step() -> Reading:
        nonlocal past
        past = own.law(ping, past if own.remembers else None).sample(rng)
        return past

    return step


def of_models(models: Mapping[str, SonarModel]) -> dict[str, Speed]:
    """Return the speed of models, with the plainest ones and one with faults beside them."""
    name, first = next(iter(models.items()))
    faulty = {f"{name} with two faults": Faulty(first, [Short(0.01), Noise(0.01)])}
    every: dict[str, SonarModel] = {"ideal": IdealModel(), "Gaussian": GaussianModel(), **models, **faulty}
    with one_thread():
        return {k: Speed({n: seconds(stepper(m, pings(n)), n) for n in LIMITS}) for k, m in every.items()}


def of_credence(tables: CredenceTable, learned: RecentCredence) -> dict[str, Speed]:
    """Return how fast credence given the readings is told: looked up, and learned from the last few of each sensor."""
    return {
        "credence given a reading, looked up": Speed({n: seconds(partial(tables.given, _said(n)), n) for n in LIMITS}),
        "credence given the last readings": Speed({n: seconds(_listening(learned, n), n) for n in LIMITS}),
    }


def _said(n: int) -> Reading:
    return GaussianModel().law(pings(n)).sample(np.random.default_rng(0))


def _listening(learned: RecentCredence, n: int) -> Callable[[], object]:
    """Return a function that takes one reading more of every sensor in and tells its credence."""
    recent, reading, time_s = Recent.nothing(learned.depth, n), _said(n), np.zeros(n)
    return lambda: learned.given(recent.then(reading, time_s))


def of_paths(model: MlpModel, paths: Mapping[str, Callable[[MlpModel], Draw]] = PATHS) -> dict[str, Speed]:
    """Return the speed of each way of drawing from a perceptron's law, and whether it draws from that law."""
    with one_thread():
        return {name: _of_path(path(model), model) for name, path in paths.items()}


def _of_path(draw: Draw, model: MlpModel) -> Speed:
    rng = np.random.default_rng(0)
    taken = {n: seconds(partial(draw, pings(n), rng), n) for n in LIMITS}
    return Speed(taken, float(disagreement(draw, model, DRAWS, rng).mean()))


def rows(speeds: Mapping[str, Speed]) -> str:
    """Return speeds as the body of a table in Markdown."""
    return "\n".join(f"| {name} | {' | '.join(cells(speed))} |" for name, speed in speeds.items())


def cells(speed: Speed) -> list[str]:
    """Return the text of a row: microseconds for few pings, milliseconds for many, and the distance from the law."""
    out = [f"{1e6 * speed.seconds[FEW]:.0f}", f"{1e3 * speed.seconds[MANY]:.1f}"]
    return out if speed.off is None else [*out, f"{max(speed.off, 0.0):.3f}"]
