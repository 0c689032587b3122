"""Properties of every law, for random parameters, and the models that need no torch."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from acquisition import EchoStatus, Ping, Reading, SettingError
from noise import CredenceTable, Faulty, GaussianModel, IdealModel, listener, load_model, model_names, simulate
from noise.beam import BeamModel
from noise.effects import CATALOGUE
from noise.faults import Noise, Short
from noise.law import EchoLaw
from noise.physical import PhysicalModel

REACH = 3.0
gaussians = st.builds(
    GaussianModel,
    sigma=st.floats(0.0, 0.2),
    sigma_per_metre=st.floats(0.0, 0.1),
    miss=st.floats(0.0, 1.0),
    resolution=st.sampled_from([0.01, 0.0254, 0.003]),
    max_range=st.just(REACH),
)
distances = st.floats(0.0, 4.0)


def every_step(model, distance):
    """Return the law of one condition, repeated for each register step, and the steps."""
    steps = np.arange(1, model.law(Ping.of(distance=distance)).last_step + 1)
    return model.law(Ping.of(distance=np.full(len(steps), distance))), steps


@settings(max_examples=60, deadline=None)
@given(gaussians, distances)
def test_cdf_is_monotonic_and_probability_is_its_difference(model, distance):
    law, steps = every_step(model, distance)
    cdf = law.cdf_step(steps)
    assert np.all(np.diff(cdf) >= -1e-15)
    assert cdf[-1] == pytest.approx(law.echo[0])
    probability = np.exp(law.log_prob(Reading.of(steps * model.resolution)))
    np.testing.assert_allclose(probability, np.diff(cdf, prepend=0.0), atol=1e-12)
    assert probability.sum() + law.no_echo[0] + law.no_answer[0] == pytest.approx(1.0, abs=1e-12)


physical = st.builds(lambda q: PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.004)], q, REACH), st.just(0.01))


@settings(max_examples=60, deadline=None)
@given(gaussians | physical, st.floats(0.3, 2.5), st.floats(0.0, 0.99), st.integers(0, 2**31))
def test_a_register_whose_steps_begin_anywhere_holds_all_probability(model, distance, share, seed):
    law, steps = every_step(model, distance)
    law.origin = -share * law.resolution
    reading = steps * law.resolution + law.origin
    inside = reading[1:-1]
    probability = np.exp(law.log_prob(Reading.of(reading)))
    assert probability.sum() + law.no_echo[0] + law.no_answer[0] == pytest.approx(1.0, abs=1e-9)
    half = 0.5 * law.resolution
    ends = (np.pad(inside + sign * half, 1, mode="edge") for sign in (-1.0, 1.0))
    np.testing.assert_allclose(probability[1:-1], law.between(*ends)[1:-1], atol=1e-9)
    drawn = law.sample(np.random.default_rng(seed)).range
    number = (drawn[drawn > 0] - law.origin) / law.resolution
    np.testing.assert_allclose(number, np.rint(number), atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(gaussians, st.floats(0.05, 2.5), st.floats(0.02, 0.3))
def test_credence_is_the_sum_over_readings_within_tolerance(model, distance, tolerance):
    law, steps = every_step(model, distance)
    right = np.abs(steps * model.resolution - distance) <= tolerance * distance + 1e-9
    brute = np.exp(law.log_prob(Reading.of(steps * model.resolution)))[right].sum()
    assert law.credence(tolerance)[0] == pytest.approx(brute, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(gaussians, st.lists(st.floats(0.01, 2.5), min_size=1, max_size=4), st.floats(0.0, 0.5), st.floats(0.013, 0.3))
def test_credence_given_a_reading_is_bayes_rule_over_the_readings_of_the_register(model, places, first, width):
    edges = np.arange(first, 2.9, width)
    table = CredenceTable.over(model, Ping.of(distance=places), edges)
    right, total = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
    for distance in places:
        law, steps = every_step(model, distance)
        reading = steps * model.resolution
        probability = np.exp(law.log_prob(Reading.of(reading)))
        true = np.abs(reading - distance) <= 0.1 * distance + 1e-9
        total += np.histogram(reading, edges, weights=probability)[0]
        right += np.histogram(reading, edges, weights=probability * true)[0]
    np.testing.assert_allclose(table.share * len(places), total, atol=1e-9)
    np.testing.assert_allclose(table.share * table.values * len(places), right, atol=1e-9)


def test_the_table_of_credence_agrees_with_readings_on_coarse_steps():
    """Known answer: of 0.2 m read on steps of 0.1 m, distances from 0.182 to 0.222 m are within 10 %."""
    ping = Ping.of(distance=np.linspace(0.1, 0.3, 40_001)[:-1])
    table = CredenceTable.over(GaussianModel(0.0, 0.0, 0.0, 0.1), ping, np.linspace(0.05, 0.95, 10))
    assert table.given(Reading.of([0.2]))[0] == pytest.approx((0.2 / 0.9 - 0.2 / 1.1) / 0.1, abs=1e-3)


def test_a_reading_outside_the_bins_has_no_credence():
    table = CredenceTable(np.array([0.5, 1.0, 3.0]), np.array([0.4, 1.0]), np.array([0.5, 0.5]))
    assert table.given(Reading.of([0.2, 0.5, 1.0, 3.0, 3.1])).tolist() == [0.0, 0.4, 1.0, 1.0, 0.0]


def test_a_table_of_a_model_in_use_leaves_its_memory_alone():
    ping, (used, twin) = Ping.of(distance=[1.0, 2.0]), (load_model("srf08-lstm").fresh() for _ in range(2))
    past = [model.law(ping).sample(np.random.default_rng(0)) for model in (used, twin)]
    CredenceTable.over(used, Ping.of(distance=np.linspace(0.1, 3.0, 30)), np.linspace(0.0, 3.0, 4))
    np.testing.assert_array_equal(used.law(ping, past[0]).echo, twin.law(ping, past[1]).echo)


@settings(max_examples=30, deadline=None)
@given(gaussians, st.floats(0.05, 3.5), st.integers(0, 2**31))
def test_samples_lie_on_the_register_and_follow_the_law(model, distance, seed):
    law = model.law(Ping.of(distance=np.full(400, distance)))
    drawn = law.sample(np.random.default_rng(seed))
    step = drawn.range[drawn.echo] / model.resolution
    np.testing.assert_allclose(step, np.rint(step), atol=1e-6)
    assert np.all((np.rint(step) >= 1) & (np.rint(step) <= law.last_step))
    # DKW: the greatest distance of an empirical cdf exceeds 0.15 with probability 2 exp(-2 400 0.15^2) = 3e-8
    for z in np.linspace(0.0, REACH, 7):
        assert abs(np.mean(drawn.echo & (drawn.range <= z)) - law.cdf(np.full(400, z))[0]) < 0.15


@settings(max_examples=40, deadline=None)
@given(gaussians, st.floats(0.05, 2.5), st.floats(0.01, 0.99))
def test_quantile_inverts_the_cdf(model, distance, p):
    law = model.law(Ping.of(distance=distance))
    q = law.quantile(p)
    if law.echo[0] == 0:
        assert q[0] == 0
    else:
        assert law.cdf(q)[0] >= p * law.echo[0] - 1e-9
        assert law.cdf(q - model.resolution)[0] <= p * law.echo[0] + 1e-9


def test_tails_are_exact():
    law = GaussianModel(sigma=0.01, sigma_per_metre=0.0).law(Ping.of(distance=[1.0, 1.0]))
    expected = stats.norm.logpdf([20.0, -20.0]) + np.log(0.1)
    # a step a tenth of sigma wide, 20 sigma out: density times width, tilted over the step by a factor sinh(1) / 1
    np.testing.assert_allclose(law.log_prob(Reading.of([1.2, 0.8])), expected + np.log(np.sinh(1.0)), atol=0.01)


def test_readings_are_determined_by_the_seed():
    ping = Ping.of(distance=np.linspace(0.1, 5.0, 50))
    model = GaussianModel()
    first, again, other = (model.law(ping).sample(np.random.default_rng(seed)).range for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)


def test_ideal_sonar_is_exact_and_gives_no_echo_beyond_its_range():
    law = IdealModel(max_range=6.0).law(Ping.of(distance=[3.0, 7.0]))
    np.testing.assert_array_equal(law.credence(), [1.0, 0.0])
    np.testing.assert_array_equal(law.no_echo, [0.0, 1.0])
    np.testing.assert_array_equal(law.log_prob(Reading.of([3.0, 0.0])), [0.0, 0.0])
    assert law.log_prob(Reading.of([3.1, 0.0]))[0] == -np.inf


def test_invalid_settings_raise():
    with pytest.raises(SettingError, match=r"GaussianModel\.sigma: expected a number from 0 to 1000 m, got -0\.1 m"):
        GaussianModel(sigma=-0.1)
    with pytest.raises(SettingError, match=r"GaussianModel\.miss: expected a number from 0 to 1, got 1\.5"):
        GaussianModel(miss=1.5)


def test_previous_readings_belong_to_a_run():
    """With frequent repeats, most readings of a run equal their predecessor, and runs differ."""
    stack = [CATALOGUE["stale_repeat"](probability=0.9), CATALOGUE["travel_time_jitter"](sigma_m=0.02)]
    model = PhysicalModel(stack)
    ping = Ping.of(distance=np.full(3000, 2.0), run=np.repeat(np.arange(30), 100))
    drawn = simulate(model, ping, np.random.default_rng(3))
    value = drawn.range.reshape(30, 100)
    repeats = np.mean(value[:, 1:] == value[:, :-1])
    # 0.9 repeats, and 0.1 draws of which one in about sqrt(4 pi) 20 = 71 agrees by chance
    assert repeats == pytest.approx(0.9 + 0.1 / 71, abs=4 * np.sqrt(0.09 / 2970))
    assert len(np.unique(value[:, 0])) > 15
    assert np.all(drawn.status == EchoStatus.ECHO)


class Columns:
    """Generators of several copies as one source: each copy's columns come from its own generator."""

    def __init__(self, seeds, columns):
        self.rngs, self.columns = [np.random.default_rng(seed) for seed in seeds], columns

    def random(self, size, /):
        *lead, n = (size,) if isinstance(size, int) else size
        assert n == self.columns * len(self.rngs)
        return np.concatenate([rng.random((*lead, self.columns)) for rng in self.rngs], axis=-1)


STACK = [CATALOGUE["travel_time_jitter"](sigma_m=0.02), CATALOGUE["dropped_reading"](probability=0.2)]
SAMPLED = {name: load_model(name) for name in model_names()} | {
    "physical": PhysicalModel(STACK),
    "beam": BeamModel(),
    "faults": Faulty(GaussianModel(), [Short(0.2), Noise(0.2)]),
    "faults on an LSTM": Faulty(load_model("srf08-lstm"), [Short(0.2)]),
}


@pytest.mark.parametrize("name", SAMPLED)
def test_laws_of_one_uniform_number_a_ping_are_sampled_equally_in_one_batch_and_apart(name):
    ping = Ping.of(distance=[0.2, 1.0, 20.0, 0.7, 2.5, 0.4], run=np.arange(6), time=0.0)
    law = listener(SAMPLED[name]).law(ping)
    assert law.uniform_per_ping == (name != "rig")
    if law.uniform_per_ping:
        together = law.sample(Columns([4, 5], 3))
        for copy, rows in enumerate((slice(0, 3), slice(3, 6))):
            apart = listener(SAMPLED[name]).law(ping[rows]).sample(np.random.default_rng(4 + copy))
            np.testing.assert_array_equal(together.range[rows], apart.range)
            np.testing.assert_array_equal(together.status[rows], apart.status)


@pytest.mark.parametrize("name", [name for name in SAMPLED if name != "rig"])
def test_arguments_are_checked_once_where_a_law_is_called_from_outside(name, monkeypatch):
    law = listener(SAMPLED[name]).law(Ping.of(distance=[0.2, 1.0], run=np.arange(2), time=0.0))
    for check in ("_per_ping", "sample"):
        own = getattr(EchoLaw, check)
        monkeypatch.setattr(EchoLaw, check, lambda *given, own=own: checks.append(given) or own(*given))
    for method, argument in (("arrival", 0.5), ("cdf", 0.5), ("quantile", 0.5), ("sample", np.random.default_rng(0))):
        checks = []
        getattr(law, method)(argument)
        assert len(checks) == 1, (method, checks)


def test_a_law_with_a_sampling_method_of_its_own_does_not_inherit_the_declaration():
    class Shuffled(EchoLaw):
        def _sample(self, rng):
            return super().sample(np.random.default_rng(int(rng.random(1)[0] * 100)))

    class Quiet(EchoLaw):
        pass

    assert not Shuffled.uniform_per_ping
    assert Quiet.uniform_per_ping


def test_the_rig_needs_a_generator():
    law = load_model("rig").law(Ping.of(distance=[1.0, 2.0], time=0.0))
    with pytest.raises(SettingError, match=r"rng: expected a numpy\.random\.Generator, got .*Columns"):
        law.sample(Columns([1], 2))
