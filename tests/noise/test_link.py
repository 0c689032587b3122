"""Link effects beyond the laws of the catalogue: a register that hangs for a while."""

import numpy as np
import pytest
import torch

from acquisition import Ping, Reading
from noise.effects import CATALOGUE, Seen
from noise.model import simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)
RUNS, PINGS = 400, 100


def hung(hold, probability=0.1, seed=0):
    """Return which readings of a sonar at 2 m are the constant, in the order of time, (RUNS, PINGS)."""
    stuck = CATALOGUE["stuck"](probability=probability, value_m=0.5, hold=hold)
    run, time = np.repeat(np.arange(RUNS), PINGS), np.tile(np.arange(PINGS) * 0.1, RUNS)
    ping = Ping.of(distance=np.full(RUNS * PINGS, 2.0), time=time, run=run)
    reading = simulate(PhysicalModel([stuck]), ping, np.random.default_rng(seed))
    return (reading.range == 0.5).reshape(RUNS, PINGS)


@pytest.mark.parametrize("hold", [0.0, 0.5, 0.95])
def test_a_register_hangs_as_often_whatever_it_holds(hold):
    """The stationary share of a two-state Markov chain is its entry rate over the sum of both."""
    error = np.sqrt(0.1 * 0.9 / (RUNS * PINGS) * (1 + hold) / (1 - hold))
    assert hung(hold).mean() == pytest.approx(0.1, abs=4 * error)


@pytest.mark.parametrize("hold", [0.0, 0.5, 0.95])
def test_what_it_holds_is_the_correlation_from_ping_to_ping(hold):
    is_stuck = hung(hold).astype(float)
    assert np.corrcoef(is_stuck[:, 1:].ravel(), is_stuck[:, :-1].ravel())[0, 1] == pytest.approx(hold, abs=0.05)


def test_runs_are_told_with_their_length():
    assert "pings at a time" not in CATALOGUE["stuck"](probability=0.1, value_m=0.5).statement()
    assert "for some 22 pings at a time" in CATALOGUE["stuck"](probability=0.1, value_m=0.5, hold=0.95).statement()


def test_without_a_past_it_hangs_as_often_as_on_average():
    stuck = CATALOGUE["stuck"](probability=0.1, value_m=0.5, hold=0.9)
    law = PhysicalModel([stuck]).law(Ping.of(distance=2.0))
    assert np.exp(law.log_prob(Reading.of([0.5])))[0] == pytest.approx(0.1)


def test_a_guess_foresees_that_it_hangs_for_a_while():
    rng = np.random.default_rng(0)
    distance = rng.uniform(0.8, 3.0, 400)
    alone, run = distance.copy(), distance.copy()
    alone[rng.random(400) < 0.1], run[120:160] = 0.333, 0.333
    (guess, *_) = CATALOGUE["stuck"].guesses(Seen(distance, np.arange(400.0), alone))
    assert guess["hold"] < 0.2
    (guess, *_) = CATALOGUE["stuck"].guesses(Seen(distance, np.arange(400.0), run))
    assert guess["hold"] > 0.9
    assert guess["probability"] == pytest.approx(0.1)
