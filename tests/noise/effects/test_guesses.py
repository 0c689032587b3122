"""Initial values that are read off the data: the far reflector, the wait within bursts, the step of the register."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from noise.effects import CATALOGUE, EchoSample
from noise.effects.medium import ASSUMED_SPEED

N = 60


def early_half(far, distance):
    """Return readings of which every other one is early, m, (n,)."""
    return np.where(np.arange(N) % 2 == 0, far, distance)


@given(st.floats(-0.015, 0.015), st.floats(0.9, 1.9))
def test_the_wait_within_bursts_is_found_by_a_sonar_with_an_error_of_its_own(error_m, wait_m):
    distance = np.full(N, 2.0)
    past = distance + error_m
    readings = 2.0 * distance - past - wait_m + error_m
    echoes = EchoSample(distance, np.arange(N) * 0.02, readings, np.full(N, 0.02), past=past)
    waits = [each["wait_m"] for each in CATALOGUE["previous_ping"].guesses(echoes) if each["trips"] == 2.0]
    assert min(abs(each - wait_m) for each in waits) <= 0.006


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
    first = next(each for each in guesses if each["trips"] == 1.0)
    assert first["far_m"] == pytest.approx(behind, abs=0.02)


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
    guesses = CATALOGUE["previous_ping"].guesses(echoes)
    assert bool(guesses) == bool(len(echoes.early.range))
    assert all(each["wait_m"] == pytest.approx(wait, abs=0.02) and each["trips"] == 2.0 for each in guesses[:1])


@pytest.mark.parametrize("name", ["quantisation", "truncation"])
def test_the_step_of_the_register_is_that_of_the_grid_of_readings(name):
    distance = np.linspace(0.3, 3.0, N)
    echoes = EchoSample(distance, np.arange(N), np.round(distance / 0.0479) * 0.0479, grid_m=0.0479)
    assert CATALOGUE[name].guesses(echoes) == [{"step_m": 0.0479}]
    assert CATALOGUE[name].guesses(EchoSample(distance, np.arange(N), distance)) == []


@given(
    st.floats(0.02, 0.3),
    st.sampled_from([0.0, 0.001, 0.02]),
    st.sampled_from([0.001, 0.01]),
    st.integers(0, 2**31),
)
@settings(max_examples=30, deadline=None)
def test_initial_values_of_ring_down_allow_every_near_reading(begins, decay, step, seed):
    rng = np.random.default_rng(seed)
    near = np.round((begins + rng.exponential(decay, 60)) / step) * step if decay else np.full(60, begins)
    near = near[near < 0.8]
    distance = np.full(len(near) + 20, 3.0)
    echoes = EchoSample(distance, np.arange(len(distance)) * 0.1, np.r_[near, distance[: len(distance) - len(near)]])
    first, *_ = CATALOGUE["ring_down"].guesses(echoes)
    assert first["range_m"] < near.min()
    assert near.min() - first["range_m"] <= 0.5 * max(step, 0.01) + 1e-9
    assert first["probability"] == pytest.approx(len(near) / len(distance))
    assert first["decay_m"] > 0.0


@pytest.mark.parametrize(
    ("near", "ambiguous"),
    [
        (np.full(40, 0.054), True),  # also the reading of a stuck register
        (np.r_[np.full(30, 0.054), np.full(10, 0.0583)], True),
        (np.full(40, 0.7), False),
        (np.linspace(0.05, 0.15, 40), False),
        (np.full(3, 0.054), False),
    ],
)
def test_ring_down_with_one_near_value_is_confused_with_a_stuck_register(near, ambiguous):
    distance = np.full(len(near) + 20, 3.0)
    echoes = EchoSample(distance, np.arange(len(distance)) * 0.1, np.r_[near, distance[: len(distance) - len(near)]])
    ring = CATALOGUE["ring_down"]
    assert "stuck" in ring.confused_with
    assert ring.ambiguous(echoes) == ambiguous


def test_few_near_readings_give_no_initial_value_of_ring_down():
    distance = np.full(20, 2.0)
    echoes = EchoSample(distance, np.arange(20.0), np.r_[0.1, 0.1, 0.1, distance[3:]])
    assert CATALOGUE["ring_down"].guesses(echoes) == []


@pytest.mark.parametrize("pause", [0.0, 60.0, 1e6])
def test_initial_values_of_a_clock_are_within_bounds_for_few_readings(pause):
    time = pause * np.arange(9.0)
    echoes = EchoSample(np.full(9, 4.0), time, np.full(9, 1.0))
    for guess in CATALOGUE["asynchronous_crosstalk"].guesses(echoes):
        CATALOGUE["asynchronous_crosstalk"](**guess)


@pytest.mark.parametrize(("early", "times", "ambiguous"), [(9, 1.0, True), (60, 1.0, False), (60, 0.0, True)])
def test_few_or_untimed_early_readings_fit_some_clock_by_chance(early, times, ambiguous):
    echoes = EchoSample(np.full(early, 4.0), times * np.linspace(0.0, 900.0, early), np.full(early, 1.0))
    assert CATALOGUE["asynchronous_crosstalk"].ambiguous(echoes) == ambiguous
    assert not CATALOGUE["false_alarm"].ambiguous(echoes)


@given(st.floats(0.3, 1.4), st.floats(0.06, 0.3), st.integers(0, 2**31))
def test_clutter_is_read_off_as_frequent_as_it_is_before_farther_targets(place, share, seed):
    rng = np.random.default_rng(seed)
    distance = rng.uniform(0.2, 3.0, 1000)
    shown = (distance > place + 0.1) & (rng.random(1000) < share)
    readings = np.where(shown, place + rng.normal(0.0, 0.001, 1000), distance)
    guess, *_ = CATALOGUE["fixed_clutter"].guesses(EchoSample(distance, np.arange(1000), readings))
    assert guess["range_m"] == pytest.approx(place, abs=0.005)
    farther = int((distance > place).sum())
    assert guess["presence"] <= shown.sum() / farther * 1.01
    assert guess["presence"] >= 0.4 * shown.sum() / farther  # an edge of a bin may divide the cluster


@given(st.floats(0.5, 3.0), st.floats(0.06, 0.3), st.integers(0, 2**31))
def test_another_sonar_is_read_off_where_it_explains_most_readings(other, share, seed):
    rng = np.random.default_rng(seed)
    distance = rng.uniform(0.2, 9.0, 1000)
    shown = (distance > 2.0 * other) & (rng.random(1000) < share)
    readings = np.where(shown, 0.5 * (distance + other), distance)
    guess, *_ = CATALOGUE["synchronous_crosstalk"].guesses(EchoSample(distance, np.arange(1000), readings))
    assert guess["other_m"] == pytest.approx(other, abs=0.005)
    assert guess["presence"] == pytest.approx(shown.mean())


@given(st.floats(0.1, 1.8), st.floats(0.1, 1.0), st.integers(0, 2**31))
def test_a_reflector_behind_the_target_is_as_frequent_as_it_is_where_that_is_not_heard(behind, share, seed):
    rng = np.random.default_rng(seed)
    distance, missed = rng.uniform(0.2, 0.8, 1000), rng.random(1000) < 0.4
    shown = missed & (rng.random(1000) < share)
    readings = np.where(shown, distance + behind, distance) + rng.normal(0.0, 0.001, 1000)
    silent = missed & ~shown
    echoes = EchoSample(distance[~silent], np.arange(1000)[~silent], readings[~silent], silent=int(silent.sum()))
    guess, *_ = CATALOGUE["background_reflector"].guesses(echoes)
    clear = shown & (behind > 0.15 * distance + 0.05)  # nearer echoes are within the tolerance of the target
    if clear.sum() > 50:
        assert guess["behind_m"] == pytest.approx(behind, abs=0.005)
        assert guess["presence"] <= 1.01 * shown.sum() / missed.sum()
