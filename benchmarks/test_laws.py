"""How fast laws are drawn on one core: for a car's eight sonars, and for 1,024 cars at once.

Run by `make benchmarks` with one thread a library; prints Markdown for docs/noise-models.md. Each number is processor
time, the best of several repetitions, since whatever else the machine does only adds to it.
"""

from __future__ import annotations

import time
import timeit

import numpy as np
import pytest

from acquisition import Ping
from noise import GaussianModel, IdealModel, SonarModel, load_model
from noise.faults import Faulty, Noise, Short

LIMITS = {8: 100e-6, 8 * 1024: 15e-3}  # s
MODELS: dict[str, SonarModel] = {
    "ideal": IdealModel(),
    "Gaussian": GaussianModel(),
    "srf08-mlp": load_model("srf08-mlp"),
    "srf08-mlp with two faults": Faulty(load_model("srf08-mlp"), [Short(0.01), Noise(0.01)]),
}


def pings(n: int) -> Ping:
    rng = np.random.default_rng(0)
    return Ping.of(rng.uniform(0.1, 5.0, n), rng.uniform(0.0, 0.5, n), reflectance=rng.uniform(0.1, 1.0, n))


def seconds(model: SonarModel, n: int) -> float:
    ping, rng, number = pings(n), np.random.default_rng(0), max(1, 160 // n)
    draw = timeit.Timer(lambda: model.law(ping).sample(rng), timer=time.process_time)
    return min(draw.repeat(max(15, 2400 // n), number)) / number


@pytest.mark.parametrize("n", LIMITS)
def test_draws_are_fast_enough_for_stepping(n: int) -> None:
    print(f"\n| model | one draw of {n} pings, us |\n|---|---|")
    taken = {name: seconds(model, n) for name, model in MODELS.items()}
    for name, value in taken.items():
        print(f"| {name} | {1e6 * value:.0f} |")
    assert taken["srf08-mlp"] <= LIMITS[n]
