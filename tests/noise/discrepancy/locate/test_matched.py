"""Shared cells compared without a model: calibrated where two files are of one sonar, sharp where they are not."""

import numpy as np
import pytest
from scipy import stats

from acquisition import Ping, Reading, Recording
from noise.discrepancy.locate.matched import compare
from noise.fitting.batch import Batch


def survey(rng, distance, angle, shift=0.0, lost=0.0, placement=0.004, pings=10):
    """Readings that share an offset inside each cell, and silence that comes in whole cells at times."""
    n = len(distance)
    error = np.repeat(rng.normal(0, placement, n) + shift, pings) + rng.normal(0, 0.003, n * pings)
    silent = (rng.random(n * pings) < lost) | np.repeat(rng.random(n) < 0.05, pings)
    truth = np.repeat(distance, pings)
    ping = Ping.of(distance=truth, angle=np.repeat(angle, pings), time=0.1 * np.arange(n * pings))
    return Batch.of(Recording.of(ping, Reading.of(np.where(silent, 0.0, np.round(truth + error, 3)))))


def grid(rng, cells=48):
    return np.round(rng.uniform(0.3, 4.0, cells), 3), np.deg2rad(rng.choice([-10.0, 0.0, 10.0], cells))


def p_of(seed, shift=lambda d, a: 0.0, lost=0.0, placement=0.004):
    rng = np.random.default_rng(seed)
    d, a = grid(rng)
    return compare(survey(rng, d, a), survey(rng, d, a, shift(d, a), lost, placement), rng)


def test_two_surveys_of_one_sonar_agree_however_cells_hang_together():
    p = [p_of(k, placement=0.008 if k % 2 else 0.004).p_value for k in range(80)]
    assert np.mean(np.array(p) < 0.05) < 0.13  # 4 expected of 80; 11 has probability 0.003
    assert stats.kstest(p, "uniform", alternative="greater").pvalue > 1e-3


@pytest.mark.parametrize(
    "change",
    [
        {"shift": lambda d, a: 0.008},
        {"shift": lambda d, a: 0.01 * np.sign(a)},  # nothing on average
        {"lost": 0.3},
    ],
)
def test_what_differs_shows(change):
    found = p_of(3, **change)
    assert found.cells == 48
    assert found.differs


def test_the_shift_is_told():
    assert p_of(4, shift=lambda d, a: 0.02).shift_m == pytest.approx(0.02, abs=0.003)


def test_files_that_share_nothing_are_not_compared():
    rng = np.random.default_rng(0)
    assert compare(survey(rng, *grid(rng)), survey(rng, *grid(rng)), rng) is None
