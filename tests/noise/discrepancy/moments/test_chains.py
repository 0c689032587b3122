"""Dependence in time: statistics keep unit variance, and a drift of the pose is no difference."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.locate.orthogonal import orthogonal_test
from noise.discrepancy.moments.bootstrap import studentised
from noise.discrepancy.moments.chains import Chains
from noise.discrepancy.moments.sample import Sample
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

LAW = Stack({"travel_time_jitter": {"sigma_m": 0.004}, "visits": {"placement_m": 0.004}})


def autoregression(rho, n, k, rng):
    out = rng.standard_normal((n, k))
    for i in range(1, n):
        out[i] = rho * out[i - 1] + np.sqrt(1.0 - rho**2) * out[i]
    return out


def variance(rho, rng, n=200, k=600):
    """Return the variance of statistics of autoregressive sums, each with its own bandwidth."""
    chains, z = Chains.of(np.zeros(n, dtype=int), np.arange(n, dtype=float)), []
    for psi in autoregression(rho, n, k, rng).T:
        length = chains.bandwidth(psi - psi.mean(), np.ones(n, dtype=bool))
        z.append(studentised(psi[:, None], np.ones(1, dtype=bool), chains, length)[0][0])
    return float(np.nanvar(z))  # nan where few independent neighbours remain


def test_statistics_of_dependent_clusters_have_nearly_unit_variance():
    rng = np.random.default_rng(0)
    assert variance(0.0, rng) == pytest.approx(1.0, abs=0.2)
    for rho in (0.3, 0.7):
        assert variance(rho, rng) == pytest.approx(1.0, abs=0.45)
        assert (1.0 + rho) / (1.0 - rho) > 1.8  # what it would be if neighbours were taken for independent


def test_the_whole_chain_is_one_cluster():
    rng = np.random.default_rng(1)
    chain = np.repeat(np.arange(30), 4)
    psi, chains = rng.standard_normal((120, 5)), Chains.of(chain, rng.random(120))
    whole = np.stack([np.bincount(chain, column) for column in psi.T], axis=1)
    np.testing.assert_allclose((chains.sums(psi, 4) ** 2).sum(axis=0), (whole**2).sum(axis=0))


@pytest.mark.parametrize("length", [1, 2, 3])
def test_sums_are_those_of_neighbours_in_time(length):
    psi, time = np.arange(6.0)[:, None], np.array([0.0, 5.0, 1.0, 4.0, 2.0, 3.0])
    sums = Chains.of(np.zeros(6, dtype=int), time).sums(psi, length)[:, 0]
    ring = psi[np.argsort(time), 0]
    expected = np.mean([(ring[np.arange(k, k + length) % 6].sum()) ** 2 for k in range(6)]) / length
    assert np.mean(sums**2) == pytest.approx(expected)


def drive(offset_m, rng, n=1500, tau_s=8.0, drift_m=0.008):
    """Return the log of a robot whose pose drifts: an Ornstein-Uhlenbeck error of the logged distance."""
    time = np.cumsum(rng.uniform(0.9, 1.1, n)) / 15.0
    period, phase = rng.uniform(15.0, 40.0, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
    distance = 2.0 + np.array([0.8, 0.4]) @ np.sin(2.0 * np.pi * time / period[:, None] + phase[:, None])
    drift = autoregression(np.exp(-1.0 / 15.0 / tau_s), n, 1, rng)[:, 0]
    read = distance + offset_m + drift_m * drift + 0.004 * rng.standard_normal(n)
    ping = Ping.of(distance=np.round(distance, 4), time=np.round(time, 3))
    return Batch.of(Recording.of(ping, Reading.of(np.round(read, 3))))


def test_a_drift_of_the_pose_is_no_difference_and_an_offset_beyond_it_is():
    p = {0.0: [], 0.04: []}
    for offset, values in p.items():
        for seed in range(12):
            rng = np.random.default_rng([seed, int(1e3 * offset)])
            sample = Sample.comparable(drive(offset, rng), drive(0.0, rng))
            values.append(orthogonal_test(LAW, LAW, sample, rng).p_value.value)
    assert np.mean(np.array(p[0.0]) < 0.05) <= 0.25  # 5 % expected; with independent pieces 10 of 12
    assert np.mean(np.array(p[0.04]) < 0.05) >= 0.75
