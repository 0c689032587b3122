"""Faults: properties of every fault on every model, and known answers for each fault."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from acquisition import Ping, Reading, SettingError
from noise import GaussianModel, IdealModel, load_model
from noise.effects import CATALOGUE
from noise.faults import Calibration, Constant, Faulty, Noise, Short
from noise.law import EchoLaw
from noise.physical import PhysicalModel

REACH, STEP = 4.0, 0.02
MODELS = {
    "ideal": IdealModel(STEP, REACH),
    "gaussian": GaussianModel(0.03, 0.01, 0.1, STEP, REACH),
    "physical": PhysicalModel([CATALOGUE["dropped_reading"](probability=0.2)], STEP, REACH),
    "learned": load_model("srf08-mlp"),
}
FAULTS = {
    "short": Short(0.2, span=3.0),
    "noise": Noise(0.2, sigma=0.15),
    "constant": Constant(0.2, value=1.0),
    "calibration": Calibration(0.2, scale=1.1, offset=0.05),
}
every_model = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
every_fault = pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)


def every_step(model, distance=1.5):
    """Return the law of one condition, repeated for each step of its register, and readings of all of them."""
    steps = np.arange(1, model.law(Ping.of(distance=distance)).last_step + 1)
    return model.law(Ping.of(distance=np.full(len(steps), distance))), Reading.of(steps * model.resolution)


@every_model
@every_fault
def test_probability_sums_to_one_and_is_the_difference_of_the_cdf(model, fault):
    law, readings = every_step(Faulty(model, [fault]))
    probability = np.exp(law.log_prob(readings))
    np.testing.assert_allclose(probability, np.diff(law.cdf(readings.range), prepend=0.0), atol=1e-9)
    assert probability.sum() + law.no_echo[0] + law.no_answer[0] == pytest.approx(1.0, abs=1e-9)


@every_model
@every_fault
def test_a_fault_of_rate_zero_leaves_the_law_unchanged(model, fault):
    null = type(fault)(**{**vars(fault), "rate": 0.0})
    law, readings = every_step(Faulty(model, [null]))
    np.testing.assert_allclose(law.log_prob(readings), every_step(model)[0].log_prob(readings), atol=1e-9)


@every_model
@every_fault
def test_samples_agree_with_log_prob(model, fault):
    faulty, n = Faulty(model, [fault]), 8000
    law, readings = every_step(faulty)
    drawn = faulty.law(Ping.of(distance=np.full(n, 1.5))).sample(np.random.default_rng(3))
    expected = n * np.r_[law.no_echo[0], np.exp(law.log_prob(readings))]
    observed = np.bincount(np.rint(drawn.range / model.resolution).astype(int), minlength=len(expected))
    few = expected < 8
    counts = [np.append(x[~few], x[few].sum()) for x in (observed, expected)]
    keep = counts[1] > 0
    assert stats.chisquare(counts[0][keep], counts[1][keep] * n / counts[1].sum()).pvalue > 1e-5


@settings(max_examples=25, deadline=None)
@given(st.tuples(*[st.just(0.0) | st.floats(1e-6, 0.25)] * 4), st.integers(0, 2**31))
def test_each_fault_occurs_at_its_rate(rates, seed):
    kinds = (Short, Noise, Constant, Calibration)
    faulty = Faulty(MODELS["gaussian"], [kind(rate) for kind, rate in zip(kinds, rates, strict=True)])
    _, cause = faulty.law(Ping.of(distance=np.full(2000, 1.0))).draw(np.random.default_rng(seed))
    for k, rate in enumerate(rates, start=1):
        assert stats.binomtest(int((cause == k).sum()), 2000, rate).pvalue > 1e-7


def test_the_posterior_of_a_cause_is_calibrated():
    faulty = Faulty(MODELS["gaussian"], [Short(0.1, span=REACH), Noise(0.2, sigma=0.2), Constant(0.05, value=1.4)])
    law = faulty.law(Ping.of(distance=np.full(40_000, 1.5)))
    reading, cause = law.draw(np.random.default_rng(0))
    posterior = law.cause_given(reading)
    np.testing.assert_allclose(posterior.sum(axis=0), 1.0)
    for k in range(len(faulty.causes)):
        for low in (0.0, 0.25, 0.5, 0.75):
            here = (posterior[k] >= low) & (posterior[k] < low + 0.25)
            if here.sum() > 50:
                gap = (cause[here] == k).mean() - posterior[k][here].mean()
                assert abs(gap) < 5 * np.sqrt(0.25 / here.sum())


def test_calibration_scales_offsets_and_drifts_with_time():
    faulty = Faulty(IdealModel(), [Calibration(1.0, scale=1.02, offset=-0.1, drift=0.01)])
    ping = Ping.of(distance=[1.0, 2.0, 2.0], time=[0.0, 0.0, 30.0])
    drawn = faulty.law(ping).sample(np.random.default_rng(0))
    np.testing.assert_allclose(drawn.range, [0.92, 1.94, 2.24], atol=1e-9)


def test_constant_gives_one_reading_and_noise_preserves_no_echo():
    stuck = Faulty(IdealModel(STEP, REACH), [Constant(1.0, value=1.01)])
    drawn = stuck.law(Ping.of(distance=[0.5, 3.0, 9.0])).sample(np.random.default_rng(0))
    assert len(set(drawn.range)) == 1
    assert abs(drawn.range[0] - 1.01) <= STEP / 2 + 1e-9
    silent = Faulty(IdealModel(STEP, REACH), [Noise(1.0)])
    assert not silent.law(Ping.of(distance=[9.0])).sample(np.random.default_rng(0)).echo.any()


class DeadLaw(EchoLaw):
    """A law without any answer."""

    def _arrival(self, z):
        return np.zeros(np.shape(z))

    @property
    def no_answer(self):
        return np.ones(len(self))


class Unplugged:
    """A model of a disconnected sensor."""

    resolution, remembers = STEP, False

    def law(self, ping, past=None):
        return DeadLaw(ping.distance, STEP, REACH)


@every_fault
def test_faults_preserve_no_answer(fault):
    law = Faulty(Unplugged(), [fault]).law(Ping.of(distance=[0.5, 1.0]))
    np.testing.assert_allclose(law.no_answer, 1.0)
    np.testing.assert_allclose(law.echo, 0.0, atol=1e-12)


def test_invalid_settings_raise_with_the_name_of_the_setting():
    with pytest.raises(SettingError, match=r"Short\.rate: expected a number from 0 to 1, got 1\.5"):
        Short(1.5)
    with pytest.raises(SettingError, match=r"Noise\.sigma: expected a number above 0 and at most 1000 m, got 0 m"):
        Noise(0.1, sigma=0.0)
    with pytest.raises(SettingError, match=r"Calibration\.scale: expected a number above 0 and at most 1000, got -1"):
        Calibration(0.1, scale=-1.0)
    with pytest.raises(SettingError, match=r"the rates of its faults sum to 1\.2, at most 1 is possible"):
        Faulty(IdealModel(), [Short(0.6), Noise(0.6)])
