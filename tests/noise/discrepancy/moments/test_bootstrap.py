"""The joint p-value of tests keeps its level, and does not pay for a test that adds nothing."""

import numpy as np
import pytest
from scipy.stats import kstest

from noise.discrepancy.moments.bootstrap import Greatest, any_of, joint, p_of_greatest, signs_of, studentised
from noise.discrepancy.result import PValue

N, K = 60, 5


def greatest_of(psi, signs):
    z, _, scaled = studentised(psi, np.ones(psi.shape[1], dtype=bool))
    draws = np.abs(signs @ scaled).max(axis=1)
    return Greatest(p_of_greatest(z, draws, psi.shape[1]), draws)


def test_a_test_beside_itself_changes_nothing():
    rng = np.random.default_rng(0)
    signs = signs_of(np.arange(N), rng)
    one = greatest_of(rng.standard_normal((N, K)), signs)
    assert joint(one, one).value == pytest.approx(one.p_value.value, abs=1e-3)


def test_a_test_of_nothing_does_not_count():
    rng = np.random.default_rng(1)
    one = greatest_of(rng.standard_normal((N, K)), signs_of(np.arange(N), rng))
    assert joint(one, Greatest(one.p_value, np.empty(0))).value == one.p_value.value


def test_joint_p_values_of_two_tests_are_uniform():
    p = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        signs, common = signs_of(np.arange(N), rng, draws=500), rng.standard_normal((N, K))
        other = np.concatenate([common[:, :2], rng.standard_normal((N, 2 * K))], axis=1)
        p.append(joint(greatest_of(common, signs), greatest_of(other, signs)).value)
    assert kstest(p, "uniform").pvalue > 0.01


def test_the_least_of_independent_p_values_is_adjusted_to_a_uniform_one():
    rng = np.random.default_rng(0)
    p = [any_of(*(PValue(float(each), 10**6) for each in rng.random(3))).value for _ in range(2000)]
    assert kstest(p, "uniform").pvalue > 0.01
    assert any_of(PValue(0.01, 2000), PValue(1.0, 0, 0)).value == pytest.approx(0.01)  # without statistics, no test


def test_sums_of_scores_that_a_register_decides_are_not_tested():
    """Under a coarse register a score is a millionth in all visits, and its least change would be certain."""
    sums = np.full((40, 1), 1e-6)
    allowed = np.ones(1, dtype=bool)
    assert np.isnan(studentised(sums, allowed)[0]).all()
    assert studentised(1e6 * sums, allowed)[0] > 6.0
