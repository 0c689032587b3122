"""The test rejects a true null at its level, finds planted differences, and agrees with a reference."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest
from sklearn.ensemble import RandomForestRegressor

from acquisition import Reading
from noise.discrepancy.locate.location import locate, size_of
from noise.discrepancy.locate.orthogonal import orthogonal_test
from noise.discrepancy.moments.nuisance import CrossFit, folds_of
from noise.discrepancy.moments.regressors import Form
from noise.discrepancy.moments.sample import Sample
from noise.discrepancy.moments.scores import ASPECTS
from noise.discrepancy.result import Aspect

DESIGNS = {
    "random": {},
    "order aliased with reflectance": {"aliased": True},
    "same conditions": {"same": True},
    "few visits": {"visits": 24},
}


def p_values(lab, n, **design):
    out = []
    for seed in range(n):
        sample = lab.pair(np.random.default_rng(seed), **design)
        tested = orthogonal_test(lab.rough, lab.rough, sample, np.random.default_rng(seed))
        out.append(tested.p_value.value)
    return np.array(out)


@pytest.mark.slow
def test_p_values_are_uniform_although_the_law_is_rough(lab):
    p = np.concatenate([p_values(lab, 15, **{"visits": 30, **design}) for design in DESIGNS.values()])
    assert kstest(p, "uniform").pvalue > 0.01
    assert np.mean(p <= 0.05) <= 0.12  # 60 nulls: 3 expected, more than 7 in 1 % of cases


@pytest.mark.slow
@pytest.mark.parametrize("name", DESIGNS)
def test_the_size_is_the_level(lab, name):
    p = p_values(lab, 300, **DESIGNS[name])
    assert kstest(p, "uniform").pvalue > 0.01
    assert 0.02 <= np.mean(p <= 0.05) <= 0.08  # two standard errors of 300 about 3 to 7 %


PLANTED = {
    "zero_offset": ({"offset_m": 0.012}, Aspect.BIAS, 0.012),
    "dropped_reading": ({"probability": 0.15}, Aspect.DETECTION, None),
    "fixed_clutter": ({"presence": 0.15, "range_m": 0.7}, Aspect.EARLY, None),
}


@pytest.mark.parametrize("effect", PLANTED)
def test_planted_differences_are_located(lab, effect):
    values, aspect, size = PLANTED[effect]
    sample = lab.pair(np.random.default_rng(5), {effect: values}, visits=120)
    tested = orthogonal_test(lab.rough, lab.rough, sample, np.random.default_rng(0))
    where = locate(tested)
    assert tested.p_value.value < 0.01
    found = next(location for location in where if location.aspect is aspect)
    if size is not None:
        assert found.size.low <= size <= found.size.high
        assert not found.region


@pytest.mark.parametrize("offset_m", [0.008, 0.02, 0.1])
@pytest.mark.parametrize("from_m", [0.0, 2.0])
def test_a_region_is_where_the_difference_is_however_large(lab, offset_m, from_m):
    recorded, simulated = lab.pair(np.random.default_rng(7), visits=120).batches
    moved = recorded.reading.range + np.where(recorded.ping.distance >= from_m, offset_m, 0.0)
    changed = replace(
        recorded, reading=Reading.of(np.where(recorded.reading.echo, moved, 0.0), recorded.reading.status)
    )
    tested = orthogonal_test(lab.rough, lab.rough, Sample(changed, simulated), np.random.default_rng(0))
    first = next(location for location in locate(tested) if location.aspect is Aspect.BIAS)
    assert set(first.region) <= {"distance"}
    low, high = first.region.get("distance", (0.0, np.inf))
    assert abs(low - from_m) < 0.5
    assert high > recorded.ping.distance.max() - 0.5


@pytest.mark.slow
def test_clutter_is_located_behind_its_range(lab):
    sample = lab.pair(np.random.default_rng(6), {"fixed_clutter": {"presence": 0.4, "range_m": 2.2}}, visits=240)
    tested = orthogonal_test(lab.rough, lab.rough, sample, np.random.default_rng(0))
    early = next(location for location in locate(tested) if location.aspect is Aspect.EARLY)
    assert early.region["distance"][0] > 1.7


def test_a_restricted_test_uses_what_it_is_told(lab):
    sample = lab.pair(np.random.default_rng(5), {"zero_offset": {"offset_m": 0.012}}, visits=100)
    rng = np.random.default_rng(0)
    tested = orthogonal_test(lab.rough, lab.rough, sample, rng, only=lambda r, a: a is Aspect.DETECTION)
    assert np.isnan(np.delete(tested.z, ASPECTS.index(Aspect.DETECTION), axis=0)).all()
    assert tested.p_value.value > 0.01


def test_no_overlap_is_no_evidence(lab):
    rng = np.random.default_rng(2)
    near, far = lab.survey(rng, visits=100, distances=(0.3, 1.5)), lab.survey(rng, visits=100, distances=(2.5, 4.0))
    changed = lab.model({**lab.truth, "zero_offset": {"offset_m": 0.02}})
    sample = Sample(lab.record(changed, near, rng), lab.record(lab.model(lab.truth), far, rng))
    tested = orthogonal_test(lab.rough, lab.rough, sample, np.random.default_rng(0))
    assert tested.overlap < 0.1
    assert tested.p_value.value > 0.01


def test_a_law_known_exactly_needs_no_simulation(lab):
    rng = np.random.default_rng(3)
    changed = lab.model({**lab.truth, "zero_offset": {"offset_m": 0.01}})
    p = []
    for law in (lab.model(lab.truth), changed):
        sample = Sample(lab.record(law, lab.survey(rng, visits=100), rng), None)
        p.append(orthogonal_test(lab.exact, lab.exact, sample, np.random.default_rng(0)).p_value.value)
    assert p[0] > 0.01 > p[1]


def test_the_same_seed_gives_the_same_result(lab):
    sample = lab.pair(np.random.default_rng(0))
    first, second = (orthogonal_test(lab.rough, lab.rough, sample, np.random.default_rng(1)) for _ in range(2))
    assert first.p_value == second.p_value


def test_the_size_agrees_with_double_machine_learning(lab):
    doubleml = pytest.importorskip("doubleml")
    sample = lab.pair(np.random.default_rng(8), {"zero_offset": {"offset_m": 0.012}}, visits=200)
    tested = orthogonal_test(lab.rough, lab.rough, sample, np.random.default_rng(0))
    group = next(g for g in tested.groups if ASPECTS.index(Aspect.BIAS) in g.aspects)
    own = size_of(tested, group, list(group.aspects).index(ASPECTS.index(Aspect.BIAS)), 0)
    error = np.concatenate([b.reading.range - lab.rough.direct(b)[0] for b in sample.batches])
    x = np.stack(list(sample.conditions.values()), axis=1)[group.valid]
    data = doubleml.DoubleMLData.from_arrays(x, error[group.valid], sample.is_recorded[group.valid] * 1.0)
    forest = RandomForestRegressor(60, min_samples_leaf=20, random_state=0)
    np.random.seed(0)  # noqa: NPY002 - doubleml divides into folds by the global generator
    reference = doubleml.DoubleMLPLR(data, forest, forest, n_folds=5).fit()
    assert own.value == pytest.approx(float(reference.coef[0]), abs=own.high - own.value)


def test_cross_fitted_means_recover_a_smooth_function():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1.0, 1.0, 600)
    y = 1.0 + x**2 + rng.normal(0.0, 0.1, 600)
    fit = CrossFit(np.stack([x**k for k in range(4)], axis=1), np.ones(600), folds_of(np.arange(600), rng), near=True)
    assert np.abs(fit.predict(y[:, None])[:, 0] - 1.0 - x**2).max() < 0.1


@pytest.mark.slow
def test_large_files_are_tested_in_seconds(lab):
    sample = lab.pair(np.random.default_rng(0), visits=2662, pings=50)
    start = time.perf_counter()
    orthogonal_test(lab.rough, lab.rough, sample, np.random.default_rng(0))
    assert time.perf_counter() - start < 30.0  # 10 s on an idle core


def test_statistics_of_what_both_files_have_have_unit_variance_with_few_visits(lab):
    square = []
    for seed in range(24):
        sample = lab.pair(np.random.default_rng(seed), visits=24)
        tested = orthogonal_test(lab.exact, lab.exact, sample, np.random.default_rng(seed))
        columns = [column for column in tested.columns for _ in column.regressors]
        shared = np.array([column.form is Form.SHARED and column.factor is None for column in columns])
        square.append(np.nanmean(tested.z[:, shared] ** 2))
    assert np.mean(square) == pytest.approx(1.0, abs=0.2)
