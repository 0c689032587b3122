"""Compiled laws give the readings of the models' laws; numbers are uniform and independent of other copies."""

import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from scipy.stats import kstest

from acquisition import Ping, Reading
from noise import GaussianModel, IdealModel, load_model
from sonar_gym.sensing.laws.choose import path_law
from sonar_gym.sensing.laws.drawn import PathPings
from sonar_gym.sensing.laws.general import GeneralLaw
from sonar_gym.sensing.laws.numbers import Streams, normal_cdf, normal_quantile

MAX_RANGE = 3.01
N = 4000


class Given:
    """A source that returns given numbers."""

    def __init__(self, rng):
        self.rng = rng

    def random(self, size):
        return self.rng.random(size)


def conditions(rng, n=N):
    """Return conditions within and beyond the learned ones, (4, n)."""
    distance = np.where(rng.random(n) < 0.1, 20.0, rng.uniform(0.01, 4.0, n))
    return np.stack([distance, rng.uniform(-0.6, 0.6, n), rng.uniform(0.0, 1.55, n), rng.uniform(0.0, 1.0, n)])


@pytest.mark.parametrize(
    "model",
    [IdealModel(), IdealModel(resolution=0.043), GaussianModel(miss=0.1), GaussianModel(sigma=0.0), "srf08-mlp"],
    ids=str,
)
def test_compiled_readings_and_credence_are_those_of_the_law(model):
    model = load_model(model) if isinstance(model, str) else model
    given = conditions(np.random.default_rng(0))
    drawn = path_law(model, N, MAX_RANGE).draw(
        PathPings(given, np.zeros(N), np.arange(N)), Given(np.random.default_rng(1))
    )
    law = model.law(Ping(*given, np.zeros(N), np.arange(N)))
    expected = law.sample(np.random.default_rng(1))
    near = expected.range <= MAX_RANGE
    same = np.abs(drawn.range - np.where(near, expected.range, 0.0)) < 1e-9
    assert np.mean(same) > 0.999  # single precision changes the few readings on the border of two steps
    assert np.max(np.abs(drawn.credence - law.credence())) < 5e-4


def test_covariates_are_those_of_the_pings_or_missing():
    model, rng = load_model("srf08-mlp"), np.random.default_rng(7)
    given, warmth = conditions(rng), np.where(rng.random(N) < 0.3, np.nan, rng.uniform(15.0, 25.0, N))
    pings = PathPings(np.vstack([given, warmth]), np.zeros(N), np.arange(N))
    credence = path_law(model, N, MAX_RANGE).draw(pings, Given(rng)).credence
    rows = np.zeros(N), np.arange(N)
    for known in (True, False):
        at = np.isnan(warmth) != known
        covariates = {"temperature_c": warmth[at]} if known else {}
        law = model.law(Ping(*given[:, at], rows[0][at], rows[1][at], covariates))
        assert np.max(np.abs(credence[at] - law.credence())) < 5e-4


@pytest.mark.parametrize("name", ["srf08-lstm", "srf08-hybrid"])
def test_a_compiled_memory_follows_that_of_the_model(name):
    model, rng, n = load_model(name), np.random.default_rng(2), 300
    compiled, general, past = path_law(model.fresh(), n, MAX_RANGE), model.fresh(), None
    given = conditions(rng, n)
    for k in range(12):
        given[0] = np.maximum(given[0] + rng.normal(0.0, 0.02, n), 0.01)
        time = np.full(n, 0.1 * k)
        drawn = compiled.draw(PathPings(given, time, np.arange(n)), Given(np.random.default_rng(k)))
        law = general.law(Ping(*given, time, np.arange(n)), past)
        past = Reading(drawn.range, drawn.status)  # both remember the same readings
        assert np.mean(np.abs(drawn.credence - law.credence())) < 2e-3
        expected = law.sample(np.random.default_rng(k))
        both = drawn.status == np.where(expected.range > MAX_RANGE, 0, expected.status)
        assert np.mean(both) > 0.97


def test_a_cleared_place_is_as_at_the_beginning():
    law, given = path_law(load_model("srf08-lstm").fresh(), 50, MAX_RANGE), conditions(np.random.default_rng(3), 50)
    pings = PathPings(given, np.zeros(50), np.arange(50))
    first = law.draw(pings, Given(np.random.default_rng(4)))
    again = law.draw(pings, Given(np.random.default_rng(4)))
    law.clear(np.arange(50))
    cleared = law.draw(pings, Given(np.random.default_rng(4)))
    assert not np.array_equal(first.credence, again.credence)
    assert np.array_equal(first.range, cleared.range)
    assert np.array_equal(first.credence, cleared.credence)


def test_a_ping_has_the_same_reading_whatever_stands_beside_it():
    law, given = path_law(load_model("srf08-mlp"), N, MAX_RANGE), conditions(np.random.default_rng(5))
    numbers = np.random.default_rng(6).random((2, N))

    class Fixed:
        def __init__(self, rows):
            self.rows = rows

        def random(self, size):
            return numbers[:, self.rows]

    whole = law.draw(PathPings(given, np.zeros(N), np.arange(N)), Fixed(slice(None)))
    part = np.arange(7, N, 11)
    alone = law.draw(PathPings(np.ascontiguousarray(given[:, part]), np.zeros(len(part)), part), Fixed(part))
    assert np.array_equal(whole.range[part], alone.range)
    assert np.array_equal(whole.credence[part], alone.credence)


def test_subclasses_are_not_compiled():
    class Mine(GaussianModel):
        pass

    assert isinstance(path_law(Mine(), 1, MAX_RANGE), GeneralLaw)


def test_each_copy_draws_as_if_it_were_alone():
    together = Streams(3, 5)
    for copy in range(3):
        together.seed(10 + copy, copy)
    numbers = together.of(np.arange(3), np.array([4, 0, 3]), 7).random((2, 7))
    more = together.of(np.arange(3), np.array([1, 2, 1]), 4).random((3, 4))
    alone = Streams(1, 5)
    alone.seed(12, 0)
    assert np.array_equal(numbers[:, 4:], alone.of(np.zeros(1, np.int64), np.array([3]), 3).random((2, 3)))
    assert np.array_equal(more[:, 3:], alone.of(np.zeros(1, np.int64), np.array([1]), 1).random((3, 1)))


def test_numbers_are_uniform_and_uncorrelated():
    streams = Streams(2, 0)
    streams.seed(1, 0), streams.seed(2, 1)
    a, b = streams.of(np.arange(2), np.array([20_000, 20_000]), 40_000).random(40_000).reshape(2, -1)
    assert kstest(a, "uniform").pvalue > 1e-3
    for x, y in ((a, b), (a[1:], a[:-1]), (a[::2], a[1::2])):
        assert abs(np.corrcoef(x, y)[0, 1]) < 0.03
    with pytest.raises(ValueError, match=r"expected \(\.\.\., n\)"):
        streams.of(np.arange(2), np.array([1, 1]), 2).random(3)


def test_the_normal_distribution_agrees_with_scipy():
    p = np.r_[np.logspace(-15, -0.31, 300), 1.0 - np.logspace(-15, -1.0, 100)]
    assert np.allclose([normal_quantile(x) for x in p], ndtri(p), rtol=1e-12, atol=1e-14)
    x = np.linspace(-8.0, 8.0, 101)
    assert np.allclose([normal_cdf(v) for v in x], ndtr(x), rtol=1e-12)
    assert np.isfinite([normal_quantile(0.0), normal_quantile(1.0)]).all()
