"""Faults strike any ping: strays that go by a condition are no fault, whatever explains their values."""

import numpy as np
import pytest
import torch

from acquisition import Ping, Reading, Recording
from noise.discrepancy import diagnose
from noise.discrepancy.checks.selective import selective
from noise.discrepancy.checks.transient import SURE_P
from noise.discrepancy.judge.rest import in_words
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)
SONAR = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.003), CATALOGUE["sensitivity"](loss_db=36.0)])
PINGS, STAYS = 8, 60


def heard(seed, faults=(), least=0.0):
    """Return stays placed to 3 mm by a sonar with faults, whose host lifts readings to the least it deems possible."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.4, 2.5, STAYS), PINGS)
    placed = distance + np.repeat(rng.normal(0, 0.003, STAYS), PINGS)
    sonar = PhysicalModel([*SONAR.effects, *faults])
    reading = simulate(sonar, Ping.of(distance=placed), rng).range
    read = np.where(reading > 0.0, np.maximum(np.round(reading, 3), least), 0.0)
    return Recording.of(Ping.of(distance=distance), Reading.of(read))


def stuck(probability=0.2):
    return CATALOGUE["stuck"](probability=probability, value_m=0.8)


def look(recording, law):
    return selective(Stack.of(law), Batch.of(recording), ["stuck"], np.random.default_rng(0))


def test_a_least_reading_goes_by_distance():
    found = look(heard(1, least=0.8), PhysicalModel([*SONAR.effects, stuck()]))
    assert found.p_value < SURE_P
    assert found.place == ("distance_mm", 0.0)
    assert found.size == pytest.approx(0.15, abs=0.1)
    assert "go by distance" in in_words(found)


def test_faults_ask_no_condition():
    law = PhysicalModel([*SONAR.effects, stuck()])
    p = np.array([look(heard(seed, [stuck()]), law).p_value for seed in range(2, 42)])
    assert np.mean(p < 0.05) <= 0.15
    assert p.min() > SURE_P
    assert 0.3 < p.mean() < 0.7


def test_nothing_is_asked_where_no_fault_is_named_or_nothing_strays():
    batch = Batch.of(heard(3, [stuck()]))
    assert selective(Stack.of(SONAR), batch, ["sound_speed"], np.random.default_rng(0)) is None
    assert look(heard(4), SONAR) is None


@pytest.mark.slow
def test_a_least_reading_is_unknown_physics_and_a_stuck_register_is_not():
    assert diagnose(SONAR, heard(5, least=0.9), seed=1).to_verdict()["verdict"] == "unknown"
    verdict = diagnose(SONAR, heard(6, [stuck()]), seed=1).to_verdict()
    assert verdict["verdict"] == "named"
    assert verdict["effects"][0]["effect"] == "stuck"


def spell(robot, seed, begins, lasts, n=1500):
    """Return the log of a robot whose sensor hangs at one reading for a while."""
    rng = np.random.default_rng(seed)
    there = robot.way(rng, n)
    reading = simulate(SONAR, Ping.of(distance=there), rng).range
    read = np.where((np.arange(n) >= begins) & (np.arange(n) < begins + lasts), 1.1, np.round(reading, 3))
    return Recording.of(Ping.of(distance=there, time=np.arange(n) * robot.pace_s), Reading.of(read))


def test_a_spell_strikes_where_the_robot_happens_to_be(robot):
    law = PhysicalModel([*SONAR.effects, stuck(0.1)])
    p = np.array([look(spell(robot, seed, 100 * seed, 250), law).p_value for seed in range(1, 12)])
    assert p.min() > SURE_P


def test_a_least_reading_goes_by_distance_on_the_way_too(robot):
    recording = spell(robot, 1, 0, 0)
    read = np.where(recording.reading.echo, np.maximum(recording.reading.range, 0.8), 0.0)
    lifted = Recording.of(recording.ping, Reading.of(read))
    law = PhysicalModel([*SONAR.effects, CATALOGUE["stuck"](probability=0.1, value_m=0.8)])
    assert look(lifted, law).p_value < SURE_P


def test_a_receiver_deaf_to_the_near_does_not_excuse_a_least_reading(robot):
    """Where the law hears no target it expects the stuck reading alone: so many of them are strays all the same."""
    recording = spell(robot, 1, 0, 0)
    read = np.where(recording.reading.echo, np.maximum(recording.reading.range, 0.8), 0.0)
    lifted = Recording.of(recording.ping, Reading.of(read))
    deaf = CATALOGUE["rearm_dead_time"](deaf_m=0.81)
    found = look(lifted, PhysicalModel([*SONAR.effects, stuck(0.006), deaf]))
    assert found.p_value < SURE_P
    assert found.place == ("distance_mm", 0.0)
