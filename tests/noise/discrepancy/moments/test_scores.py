"""Scores have mean zero under the law, whatever the step of the register."""

import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from scipy.stats import norm

from noise.discrepancy.moments.scores import ASPECTS, LIMIT, normal_scores, scores
from noise.discrepancy.result import Aspect


@pytest.mark.parametrize("step", [0.001, 0.3, 2.0, 9.0])
def test_normal_scores_of_any_step_average_to_zero(step):
    edges = ndtr(np.arange(-30.0, 30.0, step) + 0.1234)
    edges = np.r_[0.0, edges, 1.0]
    value = normal_scores(edges[:-1], edges[1:])
    assert np.abs(value @ np.diff(edges)).max() < 1e-6


def test_a_fine_step_gives_the_winsorised_hermite_polynomials():
    x = np.array([-4.0, -1.0, 0.5, 2.0])
    low, high = ndtr(x - 1e-4), ndtr(x + 1e-4)
    inside = np.clip(x, -LIMIT, LIMIT)
    excess = norm.expect(lambda z: np.clip(z, -LIMIT, LIMIT) ** 2 - 1.0)
    wanted = np.stack([inside, inside**2 - 1.0 - excess, inside**3 - 3.0 * inside])
    assert normal_scores(low, high) == pytest.approx(wanted, abs=1e-3)


def test_a_step_gives_the_conditional_mean():
    u = np.linspace(0.6, 0.9, 100_001)
    assert normal_scores(np.array([0.6]), np.array([0.9]))[0, 0] == pytest.approx(ndtri(u).mean(), abs=1e-5)


def test_scores_of_the_law_itself_have_mean_zero(lab):
    rng = np.random.default_rng(0)
    batch = lab.record(lab.model(lab.truth), lab.survey(rng, visits=400), rng)
    found = scores(lab.exact, batch)
    for a, aspect in enumerate(ASPECTS):
        sums = batch.visit_sums(found.value[:, a])
        if aspect is not Aspect.COINCIDENCE:  # too few outliers
            assert abs(sums.sum()) < 4.0 * np.sqrt((sums**2).sum()) + 1e-9, aspect


def test_an_offset_is_a_bias_of_its_size(lab):
    rng = np.random.default_rng(1)
    moved = lab.model({**lab.truth, "zero_offset": {"offset_m": 0.01}})
    found = scores(lab.exact, lab.record(moved, lab.survey(rng, visits=200), rng))
    bias = found.natural[found.valid[:, ASPECTS.index(Aspect.BIAS)], ASPECTS.index(Aspect.BIAS)]
    assert np.median(bias) == pytest.approx(0.01, abs=0.001)
