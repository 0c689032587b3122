"""The gain of an SRF08 as a loss of the echo's level."""

import warnings

import numpy as np
import pytest

from acquisition import Ping
from acquisition.bench.acoustics.receiver import gain_over_time
from acquisition.bench.acoustics.transducer import PERIOD
from noise import ExtrapolationWarning, load_model
from noise.learned.gain import GAIN, LOSS, gain_loss
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.learned.networks import MlpModel

NAMES = ("distance", "angle", "incidence", "reflectance", LOSS)


def model(seed=0):
    rng = np.random.default_rng(seed)
    gains = Ping.of([0.1, 2.0, 3.5], [0.0, 0.2, 0.6], [0.1, 0.0, 0.6], [0.1, 0.9, 0.5], gain=[0.0, 14.0, 31.0])
    inputs, head = Inputs.of(gains, NAMES), Head(near=3, fixed=2, resolution=0.01, max_range=4.0)
    shapes = ((8, inputs.width), (head.width, 8))
    return MlpModel(inputs, head, [(rng.normal(size=shape), rng.normal(size=shape[0])) for shape in shapes])


def test_a_loss_grows_with_a_lower_gain_and_is_none_before_the_cap_is_reached():
    gain = np.arange(32.0)
    loss = gain_loss(gain, np.full(32, 2.0))
    assert np.all(np.diff(loss) < 0.0)
    assert loss[[0, 31]] == pytest.approx([20.0 * np.log10(1025 / 94), 0.0])
    at_cap = 343.0 * 70e-6 / 2.0 * gain  # m; where the amplifier reaches the code of the cap
    assert np.all(gain_loss(gain, np.maximum(at_cap - 0.002, 0.0)) == 0.0)
    assert np.all(gain_loss(gain[:-1], at_cap[:-1] + 0.014) > 0.0)


@pytest.mark.parametrize("cap", [0, 14, 25, 31])
def test_the_loss_is_that_of_the_rigs_amplifier(cap):
    full, capped = (gain_over_time(code, 1000) for code in (31, cap))
    sample = np.arange(1, 1000)
    loss = gain_loss(np.full(999, float(cap)), (sample + 0.1) * PERIOD * 343.0 / 2.0)
    np.testing.assert_allclose(loss, 20.0 * np.log10(full / capped)[1:], atol=1e-9)


def test_a_ping_without_a_gain_is_at_that_of_power_up():
    given, not_given, unknown = (
        model().law(Ping.of(1.0, 0.1, 0.1, 0.5, **gain)) for gain in ({GAIN: 31.0}, {}, {GAIN: np.nan})
    )
    assert given.credence() == not_given.credence() == unknown.credence()
    assert not given.missing[0]
    assert not not_given.missing[0]


@pytest.mark.parametrize("gain", [-1.0, 32.0])
def test_a_law_says_that_a_code_does_not_exist(gain):
    with pytest.warns(ExtrapolationWarning, match="gain"):
        assert model().law(Ping.of(1.0, gain=gain)).extrapolates[0]


@pytest.mark.parametrize("name", ["srf08-mlp", "srf08-lstm", "srf08-hybrid"])
def test_shipped_laws_know_the_gain(name):
    shipped = load_model(name)
    gain = np.array([31.0, 14.0, 0.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error", ExtrapolationWarning)
        law = shipped.law(Ping.of(np.full(3, 4.0), 0.0, 0.0, 0.9, gain=gain, temperature_c=20.0))
    assert np.all(np.diff(law.echo) < 0.0)
    assert law.echo[0] > law.echo[2] + 0.5
    if shipped.remembers:
        gaps = {code: gap for code, gap in shipped.about["calibration"].items() if code.startswith("gain")}
        assert len(gaps) == 5
        assert all(abs(gap) <= 0.03 for gap in gaps.values())
