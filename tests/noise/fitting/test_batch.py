"""Readings in the order of their cells: what is a stay, what is alike, what is left out."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import Ping, Reading, Recording, RecordingError
from noise.fitting.batch import STANDS_M, Batch
from noise.fitting.visits import BLOCK, visits_of


def recording_of(distance, range_, **columns):
    return Recording.of(Ping.of(distance=distance), Reading.of(np.round(range_, 3)), **columns)


def test_conditions_that_never_repeat_are_cut_into_stretches():
    recording = recording_of(np.linspace(1, 2, 110), np.linspace(1, 2, 110))
    cell, block = visits_of(recording)
    assert np.bincount(block).max() == BLOCK
    assert np.array_equal(cell, block)


def test_blocks_are_stays_of_one_session_in_one_cell():
    distance = np.repeat(np.linspace(0.5, 3, 15), 4)
    recording = recording_of(distance, distance, session=np.tile(["a", "a", "b", "b"], 15))
    batch = Batch.of(recording)
    assert batch.n_visits == 30
    assert set(np.bincount(batch.visit)) == {2}


def test_thinning_keeps_beginnings_of_all_blocks():
    distance = np.repeat(np.linspace(0.5, 3, 20), 30)
    batch = Batch.of(recording_of(distance, distance))
    thin = batch.thin(100)
    assert thin.n_visits == 20
    assert set(np.bincount(thin.visit)) == {5}


def test_a_dead_wire_is_left_out_and_a_dead_recording_refused():
    table = recording_of(np.full(3, 1.0), [1.0, 1.0, 1.0]).table
    assert len(Batch.of(Recording(table.assign(reading_mm=[1000.0, np.nan, 1000.0])))) == 2
    with pytest.raises(RecordingError, match="no ping was answered"):
        Batch.of(Recording(table.assign(reading_mm=np.nan)))


@given(st.lists(st.sampled_from([0.0, 0.999, 1.0, 1.001]), min_size=3, max_size=40))
@settings(max_examples=40, deadline=None)
def test_an_echo_is_alike_to_the_one_before_and_silence_to_nothing(ranges):
    batch = Batch.of(recording_of(np.full(len(ranges), 1.0), np.array(ranges), session=["a"] * len(ranges)))
    expected = [False, *(here == before and here > 0.0 for before, here in pairwise(ranges))]
    assert batch.repeats.tolist() == expected


@given(st.lists(st.integers(1, 5), min_size=12, max_size=20), st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_sums_over_what_came_before_start_anew_in_every_stay(stays, seed):
    distance = np.repeat(0.5 + 0.1 * np.arange(len(stays)), stays)
    batch = Batch.of(recording_of(distance, distance))
    value = np.random.default_rng(seed).normal(size=(2, len(batch)))
    expected = np.concatenate([np.cumsum(value[:, rows], axis=1) - value[:, rows] for rows in batch.visit_rows], axis=1)
    assert batch.before(torch.from_numpy(value)).numpy() == pytest.approx(expected, abs=1e-9)


def test_a_target_stands_where_its_logged_distance_does():
    resting = np.repeat(np.linspace(0.5, 3.0, 14), 5)
    assert Batch.of(recording_of(resting, resting)).stationary.all()
    driven = np.linspace(0.5, 3.0, 4 * BLOCK)  # moves by more than STANDS_M in each stretch
    batch = Batch.of(recording_of(driven, driven))
    assert (driven[1] - driven[0]) * BLOCK > STANDS_M
    assert not batch.stationary.any()
    assert batch.stationary_rows == []
