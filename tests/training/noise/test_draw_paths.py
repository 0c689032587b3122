"""Every way of drawing from a law draws from that law, or says how far off it is."""

import numpy as np
import pytest

from acquisition import Ping
from noise import load_model
from training.noise.draw_paths import PATHS, disagreement
from training.noise.draw_speed import FEW, LIMITS, MANY, Speed, rows


@pytest.fixture(scope="module")
def model():
    return load_model("srf08-mlp")


def test_the_path_of_the_models_draws_from_their_law(model):
    assert disagreement(PATHS["numpy"](model), model, 20_000, np.random.default_rng(0)).max() < 0.012


def test_what_is_told_as_disagreement_is_disagreement(model):
    other = PATHS["numpy"](model)

    def longer(ping, rng):
        drawn = other(ping, rng)
        return type(drawn)(np.where(drawn.echo, drawn.range + 0.05, 0.0), drawn.status)

    assert disagreement(longer, model, 5_000, np.random.default_rng(0)).mean() > 0.3


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # torch's compiler, of torch
@pytest.mark.parametrize("name", ["torch, eager", "torch, compiled", "numba"])
def test_paths_that_compute_the_law_draw_from_it(model, name):
    draw, rng = PATHS[name](model), np.random.default_rng(1)
    assert disagreement(draw, model, 20_000, rng).max() < 0.012
    reading = draw(Ping.of(np.linspace(0.05, 6.0, 500)), rng)
    assert set(reading.status) <= {0, 1, 2}
    assert np.all((reading.range > 0) == reading.echo)


def test_speeds_are_told_in_the_units_of_the_table():
    row = rows({"one": Speed({FEW: 88e-6, MANY: 12.7e-3}), "two": Speed(dict.fromkeys(LIMITS, 1e-3), 0.1)})
    assert row.splitlines() == ["| one | 88 | 12.7 |", "| two | 1000 | 1.0 | 0.100 |"]
