"""Many stacks at once have the likelihoods that each has by itself."""

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.likelihood import likeliest, log_likelihood, log_likelihoods, predictive
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


def gated(distance, end_m, seed):
    """Return eight pings at each distance, with a window that ends at a range."""
    rng = np.random.default_rng(seed)
    law = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.004), CATALOGUE["range_gate"](listen_m=end_m)])
    ping = Ping.of(distance=np.repeat(distance, 8), time=np.arange(8.0 * len(distance)))
    return Batch.of(Recording.of(ping, law.law(ping).sample(rng)))


def test_readings_between_the_last_echo_and_the_first_silence_do_not_refute_the_end_of_a_range():
    """The end lies evenly between 1.7 and 2.2 m as far as one half of the visits tells."""
    gate = ("range_gate", "listen_m")
    own = gated([0.5, 1.2, 1.7, 2.2, 2.6], 1.95, 0)
    stack = Stack.of(PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.004)])).put([gate], [1.72])
    for others, expected in (([1.9], np.log(0.6)), ([2.0], np.log(0.6)), ([0.5, 2.6], 0.0)):
        other = gated(others, 1.95, 1)
        plain = log_likelihood(stack.at({gate: 1.95}), other).sum()
        nats = predictive(stack, [gate], own, other)
        assert nats.shape == (len(other),)
        assert nats.sum() - plain == pytest.approx(expected, abs=0.15)
    assert predictive(stack, [gate], own, gated([2.6], 3.0, 1)).sum() < -100.0
    np.testing.assert_array_equal(predictive(stack, [], own, other), log_likelihood(stack, other))


def nearest(batch):
    return batch.reading.range[batch.reading.echo].min()


def test_a_ring_down_nearer_than_any_that_was_fitted_does_not_refute_it():
    """The nearest of n exponential readings lies decay / n behind the start, on average."""
    start = ("ring_down", "range_m")
    jitter = CATALOGUE["travel_time_jitter"](sigma_m=0.004)
    law = PhysicalModel([jitter, CATALOGUE["ring_down"](probability=0.08, range_m=0.25, decay_m=0.05)])
    ping = Ping.of(distance=np.repeat(np.linspace(1.0, 3.0, 12), 20), time=np.arange(240.0))
    every = [Batch.of(Recording.of(ping, law.law(ping).sample(np.random.default_rng(k)))) for k in range(4)]
    other, *_, own = sorted(every, key=nearest)
    assert nearest(other) < nearest(own) - 2.0 * own.resolution
    true = Stack.of(law)
    fitted = true.at({start: nearest(own) - 0.5 * own.resolution})
    assert log_likelihood(fitted, other).sum() < log_likelihood(true, other).sum() - 5.0
    assert predictive(fitted, [start], own, other).sum() > log_likelihood(true, other).sum() - 3.0
