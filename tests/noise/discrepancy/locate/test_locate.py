"""Localisation: found where it was put, and p-values that mean what they say."""

import numpy as np
import pytest
import torch
from scipy import stats

from acquisition import Ping, Reading, Recording
from noise.discrepancy.common.splits import Split
from noise.discrepancy.locate.locate import locate
from noise.discrepancy.locate.residuals import residuals
from noise.discrepancy.locate.scan import Blocks, features, scan
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.physical import PhysicalModel

torch.set_num_threads(1)
STACK = Stack({"travel_time_jitter": {"sigma_m": 0.004}, "visits": {"placement_m": 0.003}})


def heard(seed, change=lambda d, a: d, cells=80, pings=6, lost=None):
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.3, 4.0, cells), pings)
    angle = np.repeat(rng.uniform(0, 0.5, cells), pings)
    moved = change(distance, angle) + np.repeat(rng.normal(0, 0.003, cells), pings)
    model = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.004)])
    reading = model.law(Ping.of(distance=moved)).sample(rng)
    recording = Recording.of(Ping.of(distance=distance, angle=angle), reading)
    if lost is not None:
        gone = lost(distance, angle) & (rng.random(len(distance)) < 0.5)
        recording = Recording(recording.table.assign(reading_mm=np.where(gone, 0.0, recording.table.reading_mm)))
    return Batch.of(recording)


def test_family_wise_p_values_are_not_too_small_on_null_data():
    p = []
    for seed in range(40):
        batch, rng = heard(seed), np.random.default_rng(seed)
        scanned = scan(residuals(STACK, batch, rng), batch, rng)
        p.append(scanned.p_value(scanned.best))
    # one-sided: conservative is allowed, alarms are not
    assert stats.kstest(p, "uniform", alternative="greater").pvalue > 0.01
    assert np.mean(np.array(p) <= 0.05) <= 0.15


def test_scale_error_is_a_scale_error_everywhere():
    (found, *_) = locate(STACK, heard(1, lambda d, a: 1.01 * d), np.random.default_rng(0))
    assert found.aspect == "scale"
    assert found.size == pytest.approx(0.01, rel=0.15)


def test_a_bias_in_a_corner_is_found_there():
    def corner(d, a):
        return d + 0.01 * ((d > 2.0) & (d < 3.0) & (a > 0.2))

    (found, *_) = locate(STACK, heard(2, corner, cells=200), np.random.default_rng(0))
    assert found.aspect in ("bias", "scale", "spread", "skew")
    assert found.nats > 10
    distance, angle = found.region.get("distance_mm", (300, 4000)), found.region.get("angle_deg", (0, 28.6))
    assert distance[0] < 2500 < distance[1]
    assert angle[0] < 20 < angle[1]


def test_lost_echoes_are_a_matter_of_detection():
    (found, *_) = locate(STACK, heard(3, lost=lambda d, a: d > 2.5), np.random.default_rng(0))
    assert found.aspect == "detection"
    assert found.size < -0.15
    assert found.region.get("distance_mm", (0, 4000))[1] > 3500.0


def test_parts_share_no_cell_and_cover_the_field():
    batch = heard(4)
    split = Split.of(batch, np.random.default_rng(0))
    parts = [set(part.condition) for part in (split.discover, split.confirm, split.vault)]
    assert not (parts[0] & parts[1])
    assert not (parts[0] & parts[2])
    assert not (parts[1] & parts[2])
    assert sum(map(len, parts)) == 80
    assert [len(p) for p in parts] == [40, 20, 20]
    for part in (split.discover, split.confirm, split.vault):
        assert part.ping.distance.min() < 0.9
        assert part.ping.distance.max() > 3.4


def test_how_long_a_move_took_is_no_condition():
    distance = np.repeat([1.0, 2.0, 3.0], 4)
    steady = np.array([9.0, 0.1, 0.1, 0.1, 20.0, 0.1, 0.1, 0.1, 15.0, 0.1, 0.1, 0.1])
    for interval, kept in ((steady, False), (np.where(steady > 1, steady, np.linspace(0.07, 0.13, 12)), True)):
        time = np.cumsum(interval)
        recording = Recording.of(Ping.of(distance=distance, time=time, interval_s=interval), Reading.of(distance))
        assert ("interval_s" in features(Batch.of(recording))) is kept


def erring(d, a):
    """Return where the law would put targets, were it right: it errs by 12 mm in a corner."""
    return d + 0.012 * ((d > 2.0) & (a > 0.2))


def peer_of(seed, change):
    """Return a simulation's readings as the law sees them."""
    batch = heard(seed, change, cells=120)
    return Blocks(residuals(STACK, batch, np.random.default_rng(seed)), batch)


def test_where_the_law_errs_for_both_nothing_is_found():
    p, alone = [], []
    for seed in range(30):
        batch, rng = heard(seed, erring), np.random.default_rng(seed)
        seen = residuals(STACK, batch, rng)
        against, plain = scan(seen, batch, rng, peer_of(100 + seed, erring)), scan(seen, batch, rng)
        p.append(against.p_value(against.best))
        alone.append(plain.p_value(plain.best))
    assert max(alone) < 0.05
    assert stats.kstest(p, "uniform", alternative="greater").pvalue > 0.01
    assert np.mean(np.array(p) <= 0.05) <= 0.15


def test_what_comes_on_top_of_the_laws_error_is_found_and_measured():
    batch = heard(5, lambda d, a: erring(d, a) + 0.01, cells=120)
    (found, *_) = locate(STACK, batch, np.random.default_rng(0), peer=peer_of(6, erring))
    assert found.aspect == "bias"
    assert found.size == pytest.approx(0.01, abs=0.002)
    assert found.p_value < 0.01


def test_a_region_that_the_simulation_never_saw_is_not_held_against_it():
    batch, near = heard(7), heard(8, cells=40)
    near = near.select(near.ping.distance < 1.5)
    peer = Blocks(residuals(STACK, near, np.random.default_rng(8)), near)
    scanned = scan(residuals(STACK, batch, np.random.default_rng(0)), batch, np.random.default_rng(0), peer)
    assert all(limits.get("distance_mm", (0.0, 0.0))[0] < 1500.0 for limits, _ in scanned.where)
    assert np.isfinite(scanned.statistic).all()
