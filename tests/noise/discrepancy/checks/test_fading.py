"""Silence that grows while a recording lasts is told; silence by chance, or by where the targets stood, is not."""

import numpy as np
import torch

from acquisition import Ping, Reading, Recording
from noise.discrepancy import diagnose
from noise.discrepancy.checks.fading import fading
from noise.discrepancy.checks.transient import SURE_P
from noise.discrepancy.judge.rest import in_words
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)
LOSS_DB, PINGS = 53.0, 8
JITTER = CATALOGUE["travel_time_jitter"](sigma_m=0.003)


def sonar(loss_db=LOSS_DB):
    return PhysicalModel([JITTER, CATALOGUE["sensitivity"](loss_db=float(loss_db))], max_range=6.0)


SONAR = sonar()


def heard(seed, fades_db=0.0, stays=72, walked=False):
    """Return stays placed at random, or farther and farther, of a sonar that loses `fades_db` from first to last."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(0.4, 4.0, stays)
    distance = np.repeat(np.sort(place) if walked else place, PINGS)
    time = 0.1 * np.arange(len(distance))
    read = np.zeros(len(distance))
    loss = LOSS_DB + fades_db * np.linspace(-0.5, 0.5, stays)
    for k in range(stays):
        rows = slice(PINGS * k, PINGS * (k + 1))
        read[rows] = np.round(simulate(sonar(loss[k]), Ping.of(distance=distance[rows], time=time[rows]), rng).range, 3)
    return Recording.of(Ping.of(distance=distance, time=time), Reading.of(read))


def look(recording):
    return fading(Stack.of(SONAR), Batch.of(recording))


def test_a_battery_that_fades_is_heard():
    found = look(heard(1, fades_db=12.0))
    assert found.p_value < SURE_P
    assert found.size > 0.1
    assert "more often" in in_words(found)


def test_a_sonar_that_recovers_is_heard_too():
    found = look(heard(2, fades_db=-12.0))
    assert found.p_value < SURE_P
    assert "less often" in in_words(found)


def test_a_steady_sonar_does_not_fade():
    p = np.array([look(heard(seed)).p_value for seed in range(10, 40)])
    assert np.mean(p < 0.05) <= 0.2
    assert p.min() > SURE_P


def test_where_time_is_distance_nothing_is_said():
    assert look(heard(3, fades_db=12.0, walked=True)) is None


def test_few_stays_and_untimed_pings_tell_nothing():
    assert look(heard(4, stays=20)) is None
    recording = heard(5, fades_db=12.0)
    untimed = Recording(recording.table.drop(columns=["time_s"]))
    assert look(untimed) is None


def test_a_fading_battery_is_unknown_physics():
    verdict = diagnose(SONAR, heard(6, fades_db=14.0), seed=1).to_verdict()
    assert verdict["verdict"] == "unknown"
    assert "as time goes on" in verdict["unknown"]["description"]
