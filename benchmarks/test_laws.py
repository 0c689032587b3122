"""Laws are drawn fast enough for stepping, and no other way that agrees with them does better for few and many pings.

Run by `make benchmarks` with one thread a library; prints the tables of docs/noise-models.md.
"""

from __future__ import annotations

import pytest

from noise import load_model
from training.noise.draw_speed import LIMITS, Speed, of_models, of_paths, rows

SHIPPED = ("srf08-mlp", "srf08-lstm", "srf08-hybrid")
AGREES = 0.01  # in total variation, beyond chance


@pytest.fixture(scope="module")
def paths() -> dict[str, Speed]:
    return of_paths(load_model("srf08-mlp"))


def test_draws_are_fast_enough_for_stepping() -> None:
    taken = of_models({name: load_model(name) for name in SHIPPED})
    print(f"\n{rows(taken)}")
    assert all(taken["srf08-mlp"].seconds[n] <= limit for n, limit in LIMITS.items())


@pytest.mark.timeout(900)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # torch's compiler, of torch
def test_the_path_that_is_kept_comes_nearest_to_both_limits_of_all_that_agree_with_the_law(
    paths: dict[str, Speed],
) -> None:
    print(f"\n{rows(paths)}")
    agreeing = {name: speed for name, speed in paths.items() if (speed.off or 0.0) < AGREES}
    assert set(paths) - set(agreeing) == {"table"}
    assert min(agreeing, key=lambda name: max(agreeing[name].seconds[n] / LIMITS[n] for n in LIMITS)) == "numpy"
