"""Batches: assignment to visits, repeated readings, omitted pings."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import Ping, Reading, Recording, RecordingError
from noise.fitting.batch import MAX_STATIONARY_M, Batch
from noise.fitting.visits import VISIT_PINGS, visits_of


def recording_of(distance, range_, **columns):
    return Recording.of(Ping.of(distance=distance), Reading.of(np.round(range_, 3)), **columns)


def test_conditions_that_never_repeat_are_cut_into_visits_of_fixed_length():
    recording = recording_of(np.linspace(1, 2, 110), np.linspace(1, 2, 110))
    condition, visit = visits_of(recording)
    assert np.bincount(visit).max() == VISIT_PINGS
    assert np.array_equal(condition, visit)


def test_a_visit_is_one_condition_in_one_session():
    distance = np.repeat(np.linspace(0.5, 3, 15), 4)
    recording = recording_of(distance, distance, session=np.tile(["a", "a", "b", "b"], 15))
    batch = Batch.of(recording)
    assert batch.n_visits == 30
    assert set(np.bincount(batch.visit)) == {2}


def test_a_return_to_a_position_is_another_visit_unless_single_pings_alternate():
    places = np.linspace(0.5, 3, 10)
    rounds, alternating = np.tile(np.repeat(places, 5), 3), np.tile(places, 15)
    assert Batch.of(recording_of(rounds, rounds)).n_visits == 30
    assert Batch.of(recording_of(alternating, alternating)).n_visits == 10


def test_thinning_retains_the_beginning_of_every_visit():
    distance = np.repeat(np.linspace(0.5, 3, 20), 30)
    batch = Batch.of(recording_of(distance, distance))
    thin = batch.thin(100)
    assert thin.n_visits == 20
    assert set(np.bincount(thin.visit)) == {5}


@given(st.lists(st.integers(1, 30), min_size=20, max_size=80), st.integers(30, 200))
@settings(max_examples=40, deadline=None)
def test_thinning_returns_about_as_many_pings_as_it_may(n_pings, n):
    distance = np.repeat(np.linspace(0.5, 3, len(n_pings)), n_pings)
    batch = Batch.of(recording_of(distance, distance))
    thin = batch.thin(n)
    assert len(thin) >= min(0.4 * n, len(batch))
    assert len(thin) <= max(n, 2 * thin.n_visits)


def test_pings_without_an_answer_are_omitted_and_a_recording_without_answers_is_an_error():
    table = recording_of(np.full(3, 1.0), [1.0, 1.0, 1.0]).table
    assert len(Batch.of(Recording(table.assign(reading_mm=[1000.0, np.nan, 1000.0])))) == 2
    with pytest.raises(RecordingError, match="no ping was answered"):
        Batch.of(Recording(table.assign(reading_mm=np.nan)))


@given(st.lists(st.sampled_from([0.0, 0.999, 1.0, 1.001]), min_size=3, max_size=40))
@settings(max_examples=40, deadline=None)
def test_an_echo_repeats_an_equal_echo_and_no_echo_repeats_nothing(ranges):
    batch = Batch.of(recording_of(np.full(len(ranges), 1.0), np.array(ranges), session=["a"] * len(ranges)))
    expected = [False, *(here == before and here > 0.0 for before, here in pairwise(ranges))]
    assert batch.repeats.tolist() == expected


@given(st.lists(st.integers(1, 5), min_size=12, max_size=20), st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_sums_over_earlier_pings_restart_in_every_visit(n_pings, seed):
    distance = np.repeat(0.5 + 0.1 * np.arange(len(n_pings)), n_pings)
    batch = Batch.of(recording_of(distance, distance))
    value = np.random.default_rng(seed).normal(size=(2, len(batch)))
    expected = np.concatenate([np.cumsum(value[:, rows], axis=1) - value[:, rows] for rows in batch.visit_rows], axis=1)
    assert batch.before(torch.from_numpy(value)).numpy() == pytest.approx(expected, abs=1e-9)


def test_a_target_is_stationary_if_its_logged_distance_is():
    fixed = np.repeat(np.linspace(0.5, 3.0, 14), 5)
    assert Batch.of(recording_of(fixed, fixed)).stationary.all()
    moving = np.linspace(0.5, 3.0, 4 * VISIT_PINGS)  # moves by more than MAX_STATIONARY_M in each visit
    batch = Batch.of(recording_of(moving, moving))
    assert (moving[1] - moving[0]) * VISIT_PINGS > MAX_STATIONARY_M
    assert not batch.stationary.any()


@given(
    st.sampled_from([0.01, 0.0254]),
    st.floats(0.0, 0.99),
    st.lists(st.integers(20, 99), min_size=1, max_size=9),
    st.integers(0, 2**31),
)
def test_readings_of_which_most_lie_on_the_steps_of_another_register_can_be_moved_to_it(step, share, counts, seed):
    on = step * (np.array(counts) + share)
    elsewhere = on[: len(on) // 2] + step * np.linspace(0.2, 0.8, len(on) // 2)
    ranges = np.random.default_rng(seed).permutation(np.r_[on, elsewhere])
    moved = Batch.of(Recording.of(Ping.of(np.full(len(ranges), 1.0)), Reading.of(ranges))).moved_to(step)
    assert moved is not None
    number = (on - moved.origin) / step
    np.testing.assert_allclose(number, np.rint(number), atol=1e-4)
    assert -step < moved.origin <= 0.0
    spread = np.r_[on[:1], on[0] + step * np.array([0.3, 0.5])]
    assert Batch.of(Recording.of(Ping.of(np.full(3, 1.0)), Reading.of(spread))).moved_to(step) is None
