"""Readings that hold on to the place before: dead bands, whole stays that are repeated, play in a rail."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from acquisition import Ping, Reading, Recording
from noise.discrepancy import diagnose
from noise.discrepancy.checks.held import Still, held, still
from noise.discrepancy.checks.transient import SURE_P
from noise.discrepancy.judge.rest import in_words
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import simulate
from noise.physical import PhysicalModel
from training.proof.trials.strangers import dead_band

torch.set_num_threads(1)
SONAR = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.003), CATALOGUE["sensitivity"](loss_db=36.0)])
PINGS = 8


def heard(seed, change=lambda x: x, play=0.0, far=2.5, register=1e-3, stays=60):
    """Return stays placed to 3 mm, `play` towards the place before; what is read goes through a host in its order."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(0.4, far, stays)
    side = np.sign(np.diff(place, prepend=place[0]))
    distance, stands = (np.repeat(x, PINGS) for x in (place, place - play * side + rng.normal(0, 0.003, stays)))
    time = 0.1 * np.arange(len(distance))
    read = simulate(SONAR, Ping.of(distance=stands, time=time), rng).range
    return Recording.of(Ping.of(distance=distance, time=time), Reading.of(change(register * np.rint(read / register))))


def with_dead_band(width):
    """Return a host that gives a new reading only where it differs from the last by more than `width`, m."""
    return lambda x: dead_band(width)(x, Ping.of(distance=x), np.random.default_rng(0))


def look(recording, simulated=None):
    batch = Batch.of(recording)
    usual = None if simulated is None else still(Batch.of(simulated), batch.resolution)
    return held(Stack.of(SONAR), batch, usual)


@pytest.mark.parametrize("width", [0.03, 0.1])
def test_a_dead_band_stills_readings_that_the_simulation_has_scatter(width):
    found = look(heard(1, with_dead_band(width)), heard(2))
    assert found.p_value < SURE_P
    assert found.aspect == "still"
    assert "do not change by a digit" in in_words(found)


def test_a_wide_dead_band_keeps_the_reading_of_the_place_before():
    found = look(heard(3, with_dead_band(0.4)))
    assert (found.aspect, found.p_value < SURE_P) == ("kept", True)
    assert 0.05 < found.size < 0.6


def test_a_register_in_centimetres_is_no_dead_band():
    found = look(heard(4, register=0.02), heard(5))
    assert found.p_value > SURE_P


def test_a_thing_that_answers_everywhere_is_not_kept():
    clutter = heard(6, lambda x: np.where(x > 1.0, 0.8, x))
    assert look(clutter).p_value > SURE_P


def test_play_lies_on_the_side_that_a_target_came_from():
    found = look(heard(7, play=0.004))
    assert (found.aspect, found.p_value < SURE_P) == ("play", True)
    assert found.size == pytest.approx(0.004, rel=0.5)
    assert look(heard(7, play=-0.004)).p_value > SURE_P  # overshoot is no memory of the place before


def test_honest_readings_hold_on_to_nothing():
    p = np.array([look(heard(seed), heard(seed + 100)).p_value for seed in range(20, 50)])
    assert np.mean(p < 0.05) <= 0.2
    assert p.min() > SURE_P


def test_still_stays_are_held_against_those_of_the_simulation():
    assert Still(40, 40).p_value(Still(40, 10)) < 1e-9
    assert Still(40, 40).p_value(Still(40, 39)) > 0.1
    assert Still(40, 30).p_value(Still(40, 2)) == 1.0  # calmer air, not a dead band
    assert Still(40, 40).p_value(None) == Still(5, 5).p_value(Still(40, 1)) == 1.0


def test_where_the_place_before_is_not_known_nothing_is_kept():
    batch = Batch.of(heard(8, with_dead_band(0.4)))
    batch = replace(batch, last=np.full((len(batch), 2), np.nan))
    assert held(Stack.of(SONAR), batch, None).p_value == 1.0


def test_the_latest_echo_before_is_looked_for_through_silence_and_never_in_another_run():
    reading = Reading.of(np.array([1.0, 0.0, 0.0, 2.0, 3.0]))
    recording = Recording.of(Ping.of(distance=[1.1, 1.2, 1.3, 2.1, 3.1], run=[0, 0, 0, 0, 1]), reading)
    batch = Batch.of(recording)
    order = np.argsort(batch.ping.distance)
    expected = [[np.nan, np.nan], [1.0, 1.1], [1.0, 1.1], [1.0, 1.1], [np.nan, np.nan]]
    np.testing.assert_array_equal(batch.last[order], expected)


@pytest.mark.slow
def test_a_dead_band_is_unknown_physics():
    verdict = diagnose(SONAR, heard(9, with_dead_band(0.3)), simulated=heard(10), seed=1).to_verdict()
    assert verdict["verdict"] == "unknown"
