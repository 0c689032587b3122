"""The flexible correction: null values, interpolation, save and load."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import Ping
from noise import load_model, save_model
from noise.discrepancy.baseline.emulator import folded
from noise.effects import CATALOGUE
from noise.effects.medium import ASSUMED_TEMPERATURE_C, CELSIUS
from noise.fitting.empirical import DISTANCE_KNOTS, EmpiricalModel, Flexible, interpolate
from noise.fitting.stack import Stack


def test_interpolation_equals_numpy_interp():
    x = torch.linspace(0.0, 7.0, 50, dtype=torch.float64)
    height = np.random.default_rng(0).normal(size=len(DISTANCE_KNOTS))
    found = interpolate(x, DISTANCE_KNOTS, [torch.tensor(h) for h in height])
    assert np.allclose(found.numpy(), np.interp(x.numpy(), DISTANCE_KNOTS, height))


def test_null_values_leave_the_law_unchanged():
    ping = Ping.of(distance=np.linspace(0.2, 5, 40), angle=0.2)
    jitter = CATALOGUE["travel_time_jitter"](sigma_m=0.01)
    z = np.linspace(0.1, 6, 40)
    plain, flexible = (EmpiricalModel(e).law(ping).arrival(z) for e in ([jitter], [jitter, Flexible()]))
    assert np.allclose(plain, flexible, atol=1e-12)


def test_bias_shifts_readings():
    model = EmpiricalModel([Flexible(**{f"bias_d{k}": 0.05 for k in range(len(DISTANCE_KNOTS))})])
    assert np.allclose(model.law(Ping.of(distance=[0.5, 2.0])).quantile(0.5), [0.55, 2.05], atol=0.0011)


def test_scale_and_offset_can_be_folded_into_the_correction_without_a_change_of_the_law():
    values = {"clock_scale": {"error": 0.012}, "zero_offset": {"offset_m": -0.01}, "flexible": {"bias_d3": 0.02}}
    stack = Stack(values, extra={"flexible": Flexible})
    ping = Ping.of(distance=np.linspace(0.12, 5.9, 60))
    before, after = (s.model.law(ping).quantile(0.5) for s in (stack, folded(stack)))
    assert set(folded(stack).values) == {"flexible"}
    assert np.allclose(before, after, atol=0.0011)


@given(
    st.floats(-0.05, 0.05), st.lists(st.floats(-0.3, 0.3), min_size=len(DISTANCE_KNOTS), max_size=len(DISTANCE_KNOTS))
)
@settings(max_examples=20, deadline=None)
def test_speed_of_sound_and_clock_have_the_same_effect_on_the_correction(error, bias):
    """Otherwise a correction would distinguish them, which readings without a thermometer cannot."""
    kelvin = (CELSIUS + ASSUMED_TEMPERATURE_C) / (1.0 + error) ** 2
    line = {f"bias_d{k}": height for k, height in enumerate(bias)}
    scales = {"clock_scale": {"error": error}}, {"sound_speed": {"temperature_c": kelvin - CELSIUS}}
    ping = Ping.of(distance=np.linspace(0.5, 5.0, 30), angle=0.1)
    clock, air = (
        Stack({"flexible": line, **scale}, extra={"flexible": Flexible}).model.law(ping).quantile(0.5)
        for scale in scales
    )
    assert np.allclose(clock, air, atol=0.0011)  # one step of the register


def test_save_and_load(tmp_path):
    model = EmpiricalModel([CATALOGUE["zero_offset"](offset_m=0.01), Flexible(bias_d2=0.02, silence_d7=0.3)], 0.01, 6.0)
    save_model(model, tmp_path / "m")
    again = load_model(tmp_path / "m")
    ping = Ping.of(distance=np.linspace(0.2, 6, 30))
    assert isinstance(again, EmpiricalModel)
    assert np.array_equal(again.law(ping).echo, model.law(ping).echo)
    assert np.array_equal(again.law(ping).quantile(0.4), model.law(ping).quantile(0.4))
