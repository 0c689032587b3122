"""Parts of a recording share neither a condition nor a run of a robot."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.name.folds import Folds
from noise.fitting.batch import Batch
from tests.noise.discrepancy.made import batch_of


def drives(n_runs, n_pings=150):
    """Approaches of a wall at 10 Hz."""
    n = n_runs * n_pings
    distance = np.tile(np.linspace(3.0, 0.4, n_pings), n_runs) + np.arange(n) * 1e-5
    ping = Ping.of(distance, time=np.arange(n) * 0.1, run=np.repeat(np.arange(n_runs), n_pings))
    return Batch.of(Recording.of(ping, Reading.of(np.round(distance, 3))))


@pytest.mark.parametrize("seed", range(5))
def test_no_run_of_a_robot_is_in_two_parts(seed):
    folds = Folds.of(drives(12), np.random.default_rng(seed))
    runs = [set(part.ping.run) for part in (folds.first, folds.second, folds.unseen)]
    assert all(runs)
    assert len(set.union(*runs)) == sum(map(len, runs)) == 12


def test_few_runs_are_cut_into_pieces():
    folds = Folds.of(drives(3), np.random.default_rng(0))
    assert min(map(len, (folds.first, folds.second, folds.unseen))) > 0.1 * 450


def test_no_condition_of_a_survey_is_in_two_parts():
    batch = batch_of()
    folds = Folds.of(batch, np.random.default_rng(0))
    conditions = [set(part.condition) for part in (folds.first, folds.second, folds.unseen)]
    assert len(set.union(*conditions)) == sum(map(len, conditions)) == len(np.unique(batch.condition))
    np.testing.assert_array_equal(np.unique(batch.condition[folds.is_unseen]), np.unique(folds.unseen.condition))


@pytest.mark.parametrize("seed", range(8))
def test_a_place_with_most_pings_is_not_unseen(seed):
    distance = np.r_[np.full(400, 2.65), np.random.default_rng(seed).uniform(0.9, 1.5, 300)]
    batch = Batch.of(Recording.of(Ping.of(distance, time=np.arange(700.0)), Reading.of(np.round(distance, 3))))
    folds = Folds.of(batch, np.random.default_rng(seed))
    assert len(folds.unseen) < 0.2 * len(batch)
    assert len(folds.unseen) == pytest.approx(60, abs=2)
