"""Time to sample the shipped laws, for the eight sonars of a car and for 1,024 cars, and alternatives to numpy.

Run by `make benchmarks` with one thread per library; prints the tables of docs/explanation/noise-models.md,
section Speed. Times are processor times, the best of several repetitions, as other load can only increase them.
"""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from acquisition import Ping, Reading
from benchmarks.draw_paths import PATHS, disagreement
from noise import CredenceTable, GaussianModel, IdealModel, SonarModel, listener, load_model
from noise.faults import Faulty, Noise, Short
from noise.fitting.threads import one_thread
from noise.learned.networks import MlpModel
from noise.learned.recent import N_FEATURES, RecentCredence, RecentReadings
from training.common.tables import markdown_table

SHIPPED = ("srf08-mlp", "srf08-lstm", "srf08-hybrid")
CAR, FLEET = 8, 8 * 1024  # pings
LIMITS = {CAR: 100e-6, FLEET: 15e-3}  # s
REPEATS = {CAR: (200, 20), FLEET: (8, 1)}  # repetitions, and calls in each
DRAWS = 20_000  # per condition, in the comparison of a path with the law
MAX_DISAGREEMENT = 0.01  # in total variation, beyond chance
Times = Mapping[int, float]  # s, by number of pings


def pings(n: int) -> Ping:
    """Return n random conditions, without temperature."""
    rng = np.random.default_rng(0)
    return Ping.of(rng.uniform(0.1, 5.0, n), rng.uniform(0.0, 0.5, n), reflectance=rng.uniform(0.1, 1.0, n))


def seconds(call: Callable[[], object], n: int) -> float:
    """Return the processor time of a call for n pings."""
    repeats, number = REPEATS[n]
    call()
    return min(timeit.Timer(call, timer=time.process_time).repeat(repeats, number)) / number


def times(make: Callable[[int], Callable[[], object]]) -> Times:
    """Return the processor times of a function made for each number of pings."""
    with one_thread():
        return {n: seconds(make(n), n) for n in LIMITS}


def sampler(model: SonarModel, n: int) -> Callable[[], object]:
    """Return a function that samples the next reading of n sensors."""
    ping, own, rng, past = pings(n), listener(model), np.random.default_rng(0), None

    def step() -> Reading:
        nonlocal past
        past = own.law(ping, past if own.remembers else None).sample(rng)
        return past

    return step


def readings(n: int) -> Reading:
    """Return n random readings."""
    return GaussianModel().law(pings(n)).sample(np.random.default_rng(0))


def untrained(depth: int = 8, hidden: int = 48) -> RecentCredence:
    """Return a network of the size that `sonar-gym noise-report` trains."""
    rng, sizes = np.random.default_rng(0), (depth * N_FEATURES, hidden, 1)
    layers = [(rng.normal(size=(b, a)), rng.normal(size=b)) for a, b in pairwise(sizes)]
    return RecentCredence(depth, layers, {})


def recent_credence(network: RecentCredence, n: int) -> Callable[[], object]:
    """Return a function that computes credence after one more reading of n sensors."""
    recent, reading, time_s = RecentReadings.empty(network.depth, n), readings(n), np.zeros(n)
    return lambda: network.given(recent.updated(reading, time_s))


def row(name: str, taken: Times, *more: float) -> Sequence[str]:
    """Return a row of a table: us for a car, ms for a fleet."""
    return (name, f"{1e6 * taken[CAR]:.0f}", f"{1e3 * taken[FLEET]:.1f}", *(f"{max(x, 0.0):.3f}" for x in more))


@pytest.fixture(scope="module")
def mlp() -> MlpModel:
    model = load_model("srf08-mlp")
    assert isinstance(model, MlpModel)
    return model


def test_laws_are_sampled_within_the_limits(mlp: MlpModel) -> None:
    models: dict[str, SonarModel] = {"ideal": IdealModel(), "Gaussian": GaussianModel()}
    models |= {name: load_model(name) for name in SHIPPED}
    models["srf08-mlp with two faults"] = Faulty(mlp, [Short(0.01), Noise(0.01)])
    taken = {name: times(partial(sampler, model)) for name, model in models.items()}
    table = CredenceTable.over(mlp, pings(1000), np.linspace(0.0, 6.6, 301))
    taken["credence given a reading, table"] = times(lambda n: partial(table.given, readings(n)))
    taken["credence given the last readings"] = times(partial(recent_credence, untrained()))
    rows = [row(name, one) for name, one in taken.items()]
    print(f"\n{markdown_table(('model', f'{CAR} pings, us', f'{FLEET} pings, ms'), rows)}")
    assert all(taken["srf08-mlp"][n] <= limit for n, limit in LIMITS.items())


@pytest.mark.timeout(900)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # raised by torch's compiler
def test_numpy_is_the_best_exact_path_for_both_numbers_of_pings(mlp: MlpModel) -> None:
    taken, distance = {}, {}
    for name, path in PATHS.items():
        draw, rng = path(mlp), np.random.default_rng(0)
        taken[name] = times(lambda n, draw=draw, rng=rng: partial(draw, pings(n), rng))
        distance[name] = float(disagreement(draw, mlp, DRAWS, rng).mean())
    rows = [row(name, taken[name], distance[name]) for name in taken]
    print(f"\n{markdown_table(('path', f'{CAR} pings, us', f'{FLEET} pings, ms', 'distance from the law'), rows)}")
    exact = [name for name in taken if distance[name] < MAX_DISAGREEMENT]
    assert set(taken) - set(exact) == {"table"}
    assert min(exact, key=lambda name: max(taken[name][n] / LIMITS[n] for n in LIMITS)) == "numpy"


@pytest.mark.timeout(1200)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # raised by torch's compiler
@pytest.mark.parametrize("name", ["numpy", "torch, eager", "torch, compiled", "numba"])
def test_exact_paths_sample_the_law(mlp: MlpModel, name: str) -> None:
    draw, rng = PATHS[name](mlp), np.random.default_rng(1)
    assert disagreement(draw, mlp, DRAWS, rng).max() < 0.012
    reading = draw(Ping.of(np.linspace(0.05, 6.0, 500)), rng)
    assert set(reading.status) <= {0, 1, 2}
    assert np.all((reading.range > 0) == reading.echo)


def test_disagreement_detects_an_offset(mlp: MlpModel) -> None:
    numpy_draw = PATHS["numpy"](mlp)

    def longer(ping: Ping, rng: np.random.Generator) -> Reading:
        drawn = numpy_draw(ping, rng)
        return Reading(np.where(drawn.echo, drawn.range + 0.05, 0.0), drawn.status)

    assert disagreement(longer, mlp, 5_000, np.random.default_rng(0)).mean() > 0.3
