"""What could have been seen: a planted effect of the stated size is found nine times in ten."""

import numpy as np
import pytest
from scipy.stats import nct

from noise.discrepancy.locate.orthogonal import orthogonal_test
from noise.discrepancy.locate.power import could_have_seen, least_mean, visible_aspects


@pytest.fixture(scope="module")
def least(lab):
    sample = lab.pair(np.random.default_rng(0), visits=60)
    tested = orthogonal_test(lab.exact, lab.exact, sample, np.random.default_rng(0))
    return {v.effect: v.least for v in could_have_seen(lab.exact, sample, tested, np.random.default_rng(0))}


def test_an_offset_is_the_bias_everywhere(least):
    assert 0.5 < least["zero_offset"] / least["bias"] < 2.0  # scores are winsorised, sizes are not


def test_more_visits_show_smaller_effects(lab, least):
    sample = lab.pair(np.random.default_rng(0), visits=200)
    tested = orthogonal_test(lab.exact, lab.exact, sample, np.random.default_rng(0))
    assert {v.effect: v.least for v in visible_aspects(tested)}["bias"] < 0.75 * least["bias"]


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "parameter"), [("zero_offset", "offset_m"), ("dropped_reading", "probability")])
def test_the_stated_size_is_found(lab, least, effect, parameter):
    found = 0
    for seed in range(40):
        change = {effect: {parameter: least[effect]}}
        sample = lab.pair(np.random.default_rng(100 + seed), change, visits=60)
        tested = orthogonal_test(lab.exact, lab.exact, sample, np.random.default_rng(seed))
        found += tested.p_value.value <= 0.01
    assert found >= 28  # 90 % of 40 is 36; the critical value is itself an estimate from 60 visits


@pytest.mark.parametrize("n", [14, 20, 60, 1000])
def test_the_least_mean_of_few_clusters_is_that_of_the_noncentral_t_law(n):
    critical = 3.3
    t = critical * np.sqrt((n - 1) / (n - critical**2))
    assert nct.sf(t, n - 1, least_mean(critical, n)) == pytest.approx(0.9, abs=0.02)
    assert least_mean(critical, 10) == np.inf
