"""Other things that answer: strays of one stay agree with each other, faults do not."""

import numpy as np
import pytest
import torch

from acquisition import Ping, Reading, Recording
from noise.discrepancy import diagnose
from noise.discrepancy.checks.company import USUAL, company
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)
SONAR = (CATALOGUE["travel_time_jitter"](sigma_m=0.003), CATALOGUE["sensitivity"](loss_db=36.0))
SPIKES = CATALOGUE["spike"](probability=0.3)
SURE = 1e-3


def heard(seed, model, elsewhere=lambda rng: None):
    """Return 60 stays of 10 pings; in the stays for which `elsewhere` gives a place, half of the readings are there."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(1.0, 2.5, 60), 10)
    time = np.arange(len(distance)) * 0.1
    ping = Ping.of(distance=distance, time=time)
    value = simulate(model, ping, rng).range
    for stay in np.split(np.arange(len(value)), 60):
        place = elsewhere(rng)
        if place is not None:
            there = stay[rng.random(len(stay)) < 0.5]
            value[there] = place + rng.normal(0, 0.004, len(there))
    return Recording.of(ping, Reading.of(np.round(value, 4)))


def walking(rng):
    """Return a place before the reflectors, in half of the stays."""
    return rng.uniform(0.3, 0.8) if rng.random() < 0.5 else None


def test_a_thing_that_answers_from_another_place_in_each_stay_is_seen():
    found = company(Stack.of(PhysicalModel([*SONAR, SPIKES])), Batch.of(heard(1, PhysicalModel(SONAR), walking)))
    assert found.agree > 20
    assert found.foreseen < 5
    assert found.p_value(USUAL) < 1e-9
    assert 0.3 < found.finding(USUAL).size < 0.6


def test_faults_of_single_readings_keep_no_company():
    model = PhysicalModel([*SONAR, SPIKES])
    p = [company(Stack.of(model), Batch.of(heard(seed, model))).p_value(USUAL) for seed in range(20)]
    assert min(p) > SURE


@pytest.mark.parametrize(
    "effect",
    [
        CATALOGUE["fixed_clutter"](presence=0.4, range_m=0.6),
        CATALOGUE["stuck"](probability=0.4, value_m=0.5),
        CATALOGUE["stale_repeat"](probability=0.4),
    ],
)
def test_what_the_law_foresees_is_no_company(effect):
    model = PhysicalModel([*SONAR, effect])
    found = company(Stack.of(model), Batch.of(heard(3, model)))
    assert found.p_value(USUAL) > SURE


def test_a_simulation_in_which_it_happens_as_often_is_no_worse():
    law, recording = Stack.of(PhysicalModel([*SONAR, SPIKES])), heard(1, PhysicalModel(SONAR), walking)
    usual = company(law, Batch.of(heard(2, PhysicalModel(SONAR), walking))).usual
    assert company(law, Batch.of(recording)).p_value(usual) > 0.01


def test_too_few_strays_tell_nothing():
    found = company(Stack.of(PhysicalModel(SONAR)), Batch.of(heard(4, PhysicalModel(SONAR))))
    assert found.told < 8
    assert found.p_value(USUAL) == 1.0


@pytest.mark.slow
def test_somebody_who_walks_by_is_unknown():
    found = diagnose(PhysicalModel(SONAR), heard(1, PhysicalModel(SONAR), walking), seed=0).verdict
    assert found.verdict == "unknown"
    assert "something else" in found.unknown.description
