"""A part that hardly tells a parameter does not condemn a hypothesis on another part."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.common.unseen import HEARING, SURPRISE, unseen
from noise.fitting.batch import Batch
from noise.fitting.fit import log_likelihood, maximise
from noise.fitting.stack import Stack
from noise.physical import PhysicalModel

LOSS = ("sensitivity", "loss_db")
PINGS = 20


def batch_of(heard):
    """Return a batch of stays at distances in m, each heard by all of its pings or by none."""
    distance = np.repeat(list(heard), PINGS)
    range_ = np.where(np.repeat(list(heard.values()), PINGS), distance, 0.0)
    return Batch.of(Recording.of(Ping.of(distance=distance), Reading.of(range_)))


def fit_of(batch, loss_db):
    stack = Stack.of(PhysicalModel((), resolution=0.001)).put([LOSS, HEARING], [loss_db, 0.2])
    return maximise(stack, (), batch)


def plain(fit, batch):
    return batch.visit_sums(log_likelihood(fit.stack, batch))


@pytest.fixture(scope="module")
def parts():
    # any threshold between 0.5 m and 6 m is as good for the first part; the second tells where in between
    return batch_of({0.5: True, 6.0: False}), batch_of({0.7: True, 2.0: True, 5.0: False})


def test_one_value_of_many_that_fit_alike_is_not_taken_for_the_hypothesis(parts):
    few, other = parts
    drawn = fit_of(few, 62.0)
    assert plain(drawn, other).min() < -SURPRISE
    found = unseen(drawn, [LOSS], few, other, fit_of(other, 45.0), seed=1)
    assert found.min() > plain(drawn, other).min() + SURPRISE
    assert (found <= 0.0).all()


def test_what_was_told_exactly_is_still_held_against_it():
    exact, other = batch_of({1.0: True, 1.9: True, 2.0: False, 4.0: False}), batch_of({3.0: True, 3.5: True})
    levels = np.linspace(30.0, 70.0, 161)
    best = max((fit_of(exact, loss) for loss in levels), key=lambda fit: fit.nats)
    found = unseen(best, [LOSS], exact, other, fit_of(other, 30.0), seed=1)
    assert found.sum() < -5.0


def test_a_prediction_that_holds_is_left_as_it_is(parts):
    few, other = parts
    good = fit_of(few, 45.0)
    np.testing.assert_array_equal(unseen(good, [LOSS], few, other, good, seed=1), plain(good, other))
    np.testing.assert_array_equal(unseen(good, [], few, other, good, seed=1), plain(good, other))
