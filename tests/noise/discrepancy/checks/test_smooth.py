"""Where stays lie as a smooth function of a condition: waves are seen, careless placing is not."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from scipy import stats

from acquisition import Ping, Reading, Recording
from noise.discrepancy import diagnose
from noise.discrepancy.checks.smooth import smooth, wrong_form
from noise.discrepancy.judge.rest import in_words
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)
SONAR = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.003), CATALOGUE["sensitivity"](loss_db=36.0)])


def heard(seed, stands=lambda d, a: d, stays=60):
    """Return stays of 6 pings, placed to 4 mm, on a stand that errs."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.4, 2.5, stays), 6)
    angle = np.repeat(np.deg2rad(rng.choice([-10.0, 0.0, 10.0], stays)), 6)
    there = stands(distance, angle) + np.repeat(rng.normal(0, 0.004, stays), 6)
    reading = simulate(SONAR, Ping.of(distance=there), rng)
    return Recording.of(Ping.of(distance=distance, angle=angle), Reading.of(np.round(reading.range, 4)))


def waving(d, a):
    """Return a rail whose marks are wrong by a wave, twice in a metre."""
    return d + 0.012 * np.sin(4.0 * np.pi * d)


def test_a_wave_that_averages_out_is_seen():
    found = smooth(Stack.of(SONAR), Batch.of(heard(1, waving))).finding(None)
    assert found.p_value < 1e-4
    assert found.place == ("distance_mm", 0.0)
    assert found.size == pytest.approx(0.012 / np.sqrt(2.0), rel=0.4)
    assert "neighbours in distance alike" in in_words(found)


def test_what_follows_from_the_angle_alone_is_told_so():
    found = smooth(Stack.of(SONAR), Batch.of(heard(2, lambda d, a: d + 0.01 * np.sign(a)))).finding(None)
    assert found.p_value < 1e-4
    assert found.place == ("angle_deg", 0.0)


def test_careless_placing_is_no_function_of_anything():
    p = [smooth(Stack.of(SONAR), Batch.of(heard(seed))).finding(None).p_value for seed in range(40)]
    assert stats.kstest(p, "uniform", alternative="greater").pvalue > 0.01
    assert np.mean(np.array(p) < 0.05) <= 0.15


def test_a_simulation_that_waves_alike_is_no_worse():
    usual = smooth(Stack.of(SONAR), Batch.of(heard(3, waving)))
    assert smooth(Stack.of(SONAR), Batch.of(heard(4, waving))).finding(usual).p_value > 0.01


def tied(seed, stands, stays=60):
    """Return a recording's stays with where a simulation, which waves too, has its own under the same conditions."""
    batch = Batch.of(heard(seed, lambda d, a: stands(waving(d, a), a), stays))
    rng = np.random.default_rng(seed + 1000)
    own = waving(batch.ping.distance, 0.0) - batch.ping.distance
    cell = np.unique(batch.condition, return_inverse=True)[1]
    return replace(batch, simulated_offset=own + rng.normal(0.0, 0.002, len(batch))[cell])


def test_where_conditions_are_shared_a_simulation_that_waves_hides_nothing_and_shows_nothing():
    other = smooth(Stack.of(SONAR), tied(11, lambda d, a: d + 0.006 * np.sin(9.0 * d)))
    assert other.tied
    # without them the wave that both have is the greater part
    assert other.finding(smooth(Stack.of(SONAR), Batch.of(heard(12, waving)))).p_value < 1e-3
    p = [smooth(Stack.of(SONAR), tied(seed, lambda d, a: d)).finding(None).p_value for seed in range(20, 60)]
    assert stats.kstest(p, "uniform", alternative="greater").pvalue > 0.01
    assert np.mean(np.array(p) < 0.05) <= 0.15


def test_stays_of_one_cell_are_held_against_its_simulation_once():
    batch = tied(13, lambda d, a: d, 30)
    twice = Batch.of(Recording(pd.concat([Recording.of(batch.ping, batch.reading).table] * 2, ignore_index=True)))
    assert smooth(Stack.of(SONAR), replace(twice, simulated_offset=np.zeros(len(twice)))).n_visits == 30


@pytest.mark.parametrize(("left", "wrong"), [(0.02, True), (0.002, False)])
def test_what_is_left_along_the_explanations_own_condition_is_a_wrong_form(left, wrong):
    bent = heard(7, lambda d, a: 0.97 * d + left * np.sin(4.0 * np.pi * d))
    scaled = Stack.of(PhysicalModel([*SONAR.effects, CATALOGUE["clock_scale"](error=-0.03)]))
    found = smooth(scaled, Batch.of(bent)).finding(None)
    assert wrong_form(found, Stack.of(SONAR), scaled, Batch.of(bent)) == wrong


def test_what_is_left_along_another_condition_is_another_cause():
    turned = heard(8, lambda d, a: 0.97 * d + 0.02 * np.sign(a))
    scaled = Stack.of(PhysicalModel([*SONAR.effects, CATALOGUE["clock_scale"](error=-0.03)]))
    found = smooth(scaled, Batch.of(turned)).finding(None)
    assert found.place == ("angle_deg", 0.0)
    assert not wrong_form(found, Stack.of(SONAR), scaled, Batch.of(turned))


def test_few_stays_tell_nothing():
    assert smooth(Stack.of(SONAR), Batch.of(heard(5, waving, stays=12))).finding(None).p_value == 1.0


def test_a_wrong_rail_is_unknown_physics():
    verdict = diagnose(SONAR, heard(6, waving), seed=1).to_verdict()
    assert verdict["verdict"] == "unknown"
