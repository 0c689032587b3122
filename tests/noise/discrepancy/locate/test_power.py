"""What could have been seen: a planted effect of the stated size is found nine times in ten."""

import numpy as np
import pytest
from scipy.stats import nct

from noise.discrepancy.locate.orthogonal import orthogonal_test
from noise.discrepancy.locate.power import could_have_seen, least_mean, shown_by, visible_aspects


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


@pytest.mark.parametrize(
    ("effect", "parameters", "aspects"),
    [
        ("zero_offset", {"offset_m": 0.001}, {"bias"}),
        ("dropped_reading", {"probability": 0.01}, {"detection"}),
        ("spike", {"probability": 0.02}, {"early", "late"}),
        ("stale_repeat", {"probability": 0.03}, {"repeat"}),
    ],
)
def test_an_effect_that_no_statistic_shows_is_where_it_acts(lab, effect, parameters, aspects):
    sample = lab.pair(np.random.default_rng(3), {effect: parameters}, visits=100)
    tested = orthogonal_test(lab.exact, lab.exact, sample, np.random.default_rng(0))
    law = lab.exact.at({(effect, name): value for name, value in parameters.items()})
    (place,) = shown_by([law], lab.exact, sample, tested, np.random.default_rng(0))
    assert str(place.aspect) in aspects
    assert place.region == {}
    assert place.p_value is tested.p_value


def test_without_a_cause_the_greatest_statistic_is_shown_with_its_own_p_value(lab):
    sample = lab.pair(np.random.default_rng(0), visits=60)
    tested = orthogonal_test(lab.exact, lab.exact, sample, np.random.default_rng(0))
    (place,) = shown_by([], lab.exact, sample, tested, np.random.default_rng(0))
    assert place.aspect is tested.best[0]
    assert place.p_value.value == tested.p_value.value
