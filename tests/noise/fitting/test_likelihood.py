"""Many stacks at once have the likelihoods that each has by itself."""

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.likelihood import likeliest, log_likelihood, log_likelihoods
from noise.fitting.stack import Stack
from noise.fitting.starts import nuisance_start, starting_points
from noise.physical import PhysicalModel


@pytest.fixture(scope="module")
def batch():
    rng = np.random.default_rng(3)
    truth = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.004), CATALOGUE["sensitivity"](loss_db=48.0)])
    ping = Ping.of(distance=np.repeat(np.linspace(0.3, 4.0, 20), 8), angle=0.2, time=np.arange(160.0))
    return Batch.of(Recording.of(ping, truth.law(ping).sample(rng)))


@pytest.mark.parametrize("name", CATALOGUE)
def test_stacks_evaluated_at_once_have_their_own_likelihoods(batch, name):
    law = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.004), CATALOGUE["sensitivity"](loss_db=48.0)])
    starts = starting_points(nuisance_start(Stack.of(law), batch), name, batch, np.random.default_rng(0), 2)
    alone = [log_likelihood(start, batch).sum() for start in starts]
    np.testing.assert_allclose(log_likelihoods(starts, batch), alone, rtol=1e-9, atol=1e-6)
    assert likeliest(starts, batch) is starts[int(np.argmax(alone))]
