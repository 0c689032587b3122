"""Initial values that are read off the data: the far reflector, the wait within bursts, the step of the register."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from noise.effects import CATALOGUE, EchoSample
from noise.effects.medium import ASSUMED_SPEED

N = 60


def early_half(far, distance):
    """Return readings of which every other one is early, m, (n,)."""
    return np.where(np.arange(N) % 2 == 0, far, distance)


@given(st.floats(11.0, 14.0), st.floats(0.062, 0.066), st.integers(0, 2**31))
def test_the_far_reflector_is_read_off_early_readings_and_intervals(far, interval, seed):
    rng = np.random.default_rng(seed)
    gap = ASSUMED_SPEED * interval / 2.0
    distance = np.full(N, max(far - gap, 0.1) + 2.0)
    readings = early_half(max(far - gap, 0.1) + rng.normal(0.0, 0.003, N), distance)
    echoes = EchoSample(distance, np.arange(N) * interval, readings, np.full(N, interval))
    fixed, *_ = CATALOGUE["previous_ping"].guesses(echoes)
    assert fixed["far_m"] == pytest.approx(max(far - gap, 0.1) + gap, abs=0.02)
    assert fixed["wait_m"] == fixed["trips"] == 0.0


@given(st.floats(0.0, 3.0), st.integers(0, 2**31))
def test_what_is_behind_a_moving_target_is_read_off_where_it_was(behind, seed):
    rng = np.random.default_rng(seed)
    distance, interval, gap = rng.uniform(4.5, 6.0, N), np.full(N, 0.025), ASSUMED_SPEED * 0.0125
    before = distance + rng.choice([-0.03, 0.05], N)
    readings = early_half(before + behind - gap + rng.normal(0.0, 0.003, N), distance)
    guesses = CATALOGUE["previous_ping"].guesses(
        EchoSample(distance, np.arange(N) * 0.025, readings, interval, before=before)
    )
    assert all(each["far_m"] == pytest.approx(behind, abs=0.02) for each in guesses if each["trips"] == 1.0)
    assert any(each["trips"] == 1.0 for each in guesses)


@given(st.floats(0.15, 0.7), st.integers(0, 2**31))
def test_the_end_of_a_ring_down_is_where_nearer_targets_are_read(end, seed):
    rng = np.random.default_rng(seed)
    distance = np.r_[rng.uniform(0.02, end - 0.1, N // 2), rng.uniform(1.0, 3.0, N)]
    readings = np.maximum(distance, end) + rng.normal(0.0, 0.002, len(distance))
    guess = CATALOGUE["ring_down"].guesses(EchoSample(distance, np.arange(len(distance)), readings))[-1]
    assert guess["range_m"] == pytest.approx(end, abs=0.01)
    assert guess["held"] > 0.5
    assert guess["probability"] == 0.0


@given(st.floats(0.05, 1.5), st.integers(0, 2**31))
def test_the_wait_within_bursts_is_read_off_the_readings_before(wait, seed):
    rng = np.random.default_rng(seed)
    distance = rng.uniform(2.5, 3.0, N)
    readings = early_half(distance - wait + rng.normal(0.0, 0.003, N), distance)  # x = 2 D - D - w after the target
    echoes = EchoSample(distance, np.arange(N) * 0.01, readings, None, distance)
    guess = CATALOGUE["previous_ping"].guesses(echoes)
    near = echoes.early.range
    assert len(guess) == (1 if len(near) else 0)
    assert all(each["wait_m"] == pytest.approx(wait, abs=0.02) and each["trips"] == 2.0 for each in guess)


@pytest.mark.parametrize("name", ["quantisation", "truncation"])
def test_the_step_of_the_register_is_that_of_the_grid_of_readings(name):
    distance = np.linspace(0.3, 3.0, N)
    echoes = EchoSample(distance, np.arange(N), np.round(distance / 0.0479) * 0.0479, grid_m=0.0479)
    assert CATALOGUE[name].guesses(echoes) == [{"step_m": 0.0479}]
    assert CATALOGUE[name].guesses(EchoSample(distance, np.arange(N), distance)) == []
