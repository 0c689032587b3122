"""The smooth correction: null, aspects, gradients, files, and what it learns."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from acquisition import ModelError, Ping, Recording
from noise import load_model, save_model
from noise.effects import CATALOGUE
from noise.effects.state import Conditions
from noise.fitting.batch import Batch
from noise.fitting.empirical import EmpiricalModel, PlacementScatter
from noise.fitting.fit import maximise
from noise.fitting.learn_smooth import learn_smooth
from noise.fitting.likelihood import at_each, log_likelihood
from noise.fitting.smooth import HEADS, MIRRORED, SHIFT, SPREAD, Inputs, Sizes, Smooth, column, term_of
from noise.fitting.smooth_basis import single_log_prob
from noise.fitting.stack import LeftOut, Stack
from noise.fitting.starts import nuisance_start
from noise.fitting.visit_effects import law_of, log_prob, single_ping_law
from noise.physical import PhysicalModel

NAMES = ("log_distance", "angle", "incidence", "reflectance")
JITTER = CATALOGUE["travel_time_jitter"](sigma_m=0.004)
SIZES = Sizes((0.1, 0.2), 0.003, 0.0, (0.004, 0.0))


def ping(n=40, seed=0):
    rng = np.random.default_rng(seed)
    return Ping.of(
        rng.uniform(0.2, 4.0, n), angle=rng.choice([0.0, 0.2, 0.4], n), reflectance=rng.choice([0.1, 0.9], n)
    )


def term(weight=0.0, kind=Smooth):
    """A correction with random weights of a given size."""
    rng = np.random.default_rng(3)
    inputs = Inputs.of(NAMES, Conditions.of(ping()))
    centres = inputs.standardised(Conditions.of(ping(12)))
    alpha, beta = ({head: torch.tensor(weight * rng.normal(size=k)) for head in HEADS} for k in (12, 3))
    return kind(inputs, centres, alpha, torch.tensor([-1.0, 0.0, 1.0]), beta, SIZES)


def survey(model, n_visits=60, n_pings=8, seed=1, shift=None):
    """A recording with independent readings of a model, at distances shifted by a function of the ping."""
    visits = ping(n_visits, seed)
    every = visits[np.repeat(np.arange(n_visits), n_pings)]
    true = every if shift is None else Ping.of(every.distance + shift(every), every.angle, every.incidence)
    return Batch.of(Recording.of(every, model.law(true).sample(np.random.default_rng(seed))))


def fitted(batch):
    stack = nuisance_start(Stack.of(PhysicalModel([JITTER], batch.resolution)), batch)
    return maximise(stack, [("travel_time_jitter", "sigma_m"), ("visits", "placement_m")], batch).stack


def test_without_aspects_the_law_is_unchanged():
    none = Smooth(term().inputs, term().centres, {}, torch.zeros(1, dtype=torch.float64), {}, SIZES)
    z = np.linspace(0.1, 5.0, 40)
    assert np.array_equal(*(EmpiricalModel(e).law(ping()).arrival(z) for e in ([JITTER], [JITTER, none])))


def test_a_corrected_loud_echo_is_heard_whatever_the_level_scatters_between_visits():
    scatter = PlacementScatter(level_sd_db=9.0)
    zero = Smooth(*_parts(term()), replace(SIZES, level_sd_db=9.0))
    plain, smooth = (EmpiricalModel(effects).law(ping()).echo for effects in ([scatter], [scatter, zero]))
    assert plain.min() > 0.999
    assert smooth.min() > 0.999


def test_each_ping_has_the_correction_of_its_part():
    terms = [term(weight) for weight in (0.1, 0.2, 0.3)]
    batch = survey(PhysicalModel([JITTER]))
    law = replace(Stack.of(EmpiricalModel([JITTER, terms[0]])), left_out=LeftOut(tuple(terms[1:]), batch.condition))
    part = batch.visit % 3 - 1

    def nats(stack, rows):
        def measure(model, visits):
            return log_prob(law_of(model, rows), visits, rows, exact=True)

        return at_each(stack, [("zero_offset", "offset_m")], np.array([[-0.01], [0.01]]), measure)

    whole = nats(law.by_part(part), batch)
    for k, each in enumerate(terms):
        rows = part == k - 1
        assert whole[:, rows] == pytest.approx(nats(law.with_term(each), batch.select(rows)), abs=1e-9)


@pytest.mark.parametrize("added_m", [0.0, 0.003, 0.02])
def test_more_scatter_than_the_correction_was_fitted_to_adds_to_it(added_m):
    correction = term(0.5)
    conditions = Conditions.of(ping())

    def spread(sigma_m):
        state = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=sigma_m)]).state(conditions)
        return correction.corrected(state, {SPREAD: correction.heads(state)[SPREAD]}).direct.spread.numpy()

    np.testing.assert_allclose(spread(np.hypot(0.004, added_m)), np.hypot(spread(0.004), added_m), rtol=1e-5)
    assert np.ptp(spread(0.004)) > 0.001


def _parts(of):
    return of.inputs, of.centres, of.alpha, of.level_centres, of.beta


def test_zero_weights_change_no_probability_by_more_than_the_floor_of_the_tails():
    z = np.linspace(0.1, 5.0, 40)
    plain, smooth = (EmpiricalModel(e).law(ping()).arrival(z) for e in ([JITTER], [JITTER, term()]))
    assert np.allclose(plain, smooth, atol=1e-3)


def test_probabilities_of_a_corrected_law_sum_to_one_and_match_its_samples():
    law = EmpiricalModel([JITTER, term(0.3)], 0.05, 6.0).law(ping(5))
    steps = np.arange(1, law.last_step + 1)[:, None] + np.zeros(5, dtype=np.int64)
    assert np.allclose(np.diff(law.cdf_step(steps), axis=0, prepend=0.0).sum(axis=0) + law.no_echo, 1.0)
    big = EmpiricalModel([JITTER, term(0.3)], 0.05, 6.0).law(ping(5)[np.repeat(np.arange(5), 4000)])
    reading = big.sample(np.random.default_rng(0))
    # four standard errors of a share of 4,000
    assert np.allclose(reading.echo.reshape(5, -1).mean(axis=1), law.echo, atol=0.032)


def test_gradients_pass_through_the_correction():
    batch = survey(PhysicalModel([JITTER]))
    stack = nuisance_start(Stack.of(PhysicalModel([JITTER])), batch).with_term(term(0.2))
    key = ("sensitivity", "loss_db")

    def nats(value):
        return float(log_likelihood(stack.put([key], [value]), batch).sum())

    number = torch.tensor([40.0], dtype=torch.float64, requires_grad=True)
    model, visits = stack.build([key], number)
    log_prob(law_of(model, batch), visits, batch).sum().backward()
    assert float(number.grad[0]) == pytest.approx((nats(40.001) - nats(39.999)) / 0.002, rel=1e-3)


def test_a_saved_model_has_the_same_law(tmp_path):
    model = EmpiricalModel([JITTER, term(0.2), PlacementScatter(sigma_m=0.01)], 0.01, 6.0)
    again = load_model(save_model(model, tmp_path / "model"))
    z = np.linspace(0.1, 5.0, 40)
    assert np.allclose(model.law(ping()).arrival(z), again.law(ping()).arrival(z), atol=1e-12)


@pytest.mark.parametrize("damage", [{"alpha": {}}, {"tails_m": [0.0, 1.0]}, {"term": "other"}, {"centres": [[1.0]]}])
def test_a_damaged_term_is_a_clear_error(damage):
    data = {**json.loads(json.dumps(term(0.1).to_dict())), **damage}
    with pytest.raises(ModelError, match="smooth term: cannot be built"):
        term_of(data)


def test_a_missing_column_is_a_clear_error():
    with pytest.raises(ModelError, match="needs the column 'humidity_pct'"):
        column("humidity_pct", Conditions.of(ping()))


def test_a_mirror_image_of_a_scene_is_the_same_condition():
    angle, incidence = np.array([0.3, -0.3, 0.3, -0.3, 0.0, 0.0]), np.array([0.1, -0.1, -0.1, 0.1, 0.1, -0.1])
    value = column(MIRRORED, Conditions.of(Ping.of(1.0, angle, incidence))).numpy()
    np.testing.assert_allclose(value, [0.1, 0.1, -0.1, -0.1, 0.1, 0.1])


def test_the_mean_stands_for_a_covariate_that_was_not_logged():
    def logged(value):
        return Conditions.of(replace(ping(), covariates={"temperature_c": np.broadcast_to(value, 40)}))

    inputs = Inputs.of((*NAMES, "temperature_c"), logged(np.linspace(15.0, 25.0, 40)))
    assert "temperature_c" in inputs.names
    assert torch.allclose(inputs.standardised(Conditions.of(ping())), inputs.standardised(logged(20.0)))


def test_beyond_the_fitted_range_the_correction_is_constant():
    inputs = term().inputs
    near, far = (inputs.standardised(Conditions.of(Ping.of([d]))) for d in (10.0, 100.0))
    assert torch.equal(near, far)


def test_a_smooth_bias_is_learned_and_reduces_the_error_under_unseen_conditions():
    def shift(p):
        return 0.03 * np.sin(2.0 * p.distance)

    train, test = (survey(PhysicalModel([JITTER]), seed=seed, shift=shift) for seed in (1, 2))
    stack = fitted(train)
    smooth = learn_smooth(stack, train, [NAMES], single_log_prob, np.random.default_rng(0)).stack
    assert SHIFT in smooth.terms[0].alpha
    before, after = (np.mean(np.abs(s.expected(test) - test.ping.distance - shift(test.ping))) for s in (stack, smooth))
    assert after < 0.3 * before


def test_readings_of_the_law_itself_are_hardly_corrected():
    train, test = (survey(PhysicalModel([JITTER]), seed=seed) for seed in (1, 2))
    stack = fitted(train)
    smooth = learn_smooth(stack, train, [NAMES], single_log_prob, np.random.default_rng(0)).stack
    loss = log_likelihood(stack, test).sum() - log_likelihood(smooth, test).sum()
    assert loss < 5.0  # nats in 480 readings


def test_the_law_of_single_pings_includes_the_placement():
    batch = survey(PhysicalModel([JITTER]))
    stack = fitted(batch).put([("visits", "placement_m")], [0.02])
    law = stack.single_ping_model.law(batch.ping)
    with torch.no_grad():
        model, visits = stack.build()
        expected = single_ping_law(law_of(model, batch), visits).log_prob(batch.reading)
    assert np.allclose(law.log_prob(batch.reading), expected, atol=1e-9)
