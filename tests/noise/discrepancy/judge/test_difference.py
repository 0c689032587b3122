"""Causes act on a simulator's readings only where these then predict the recording no worse."""

import numpy as np
import pytest

from noise.discrepancy.baseline.transport import Transport
from noise.discrepancy.judge.difference import worsens
from noise.discrepancy.judge.held_out import Simulation
from tests.noise.discrepancy.made import batch_of, model_of

LOUD = {"sensitivity": {"loss_db": 0.0}}


def moved(offset_m):
    return {**LOUD, "zero_offset": {"offset_m": offset_m}}


@pytest.mark.parametrize(("offset_m", "expected"), [(0.03, False), (-0.03, True), (0.09, True)])
@pytest.mark.parametrize("elsewhere", [False, True])
def test_what_makes_readings_predict_worse_is_seen_under_common_conditions(offset_m, expected, elsewhere):
    simulation = Simulation(model_of(LOUD), batch_of(LOUD, seed=1))
    recorded = batch_of(moved(0.03), seed=2 if elsewhere else 1)
    acting = Transport(model_of(LOUD), model_of(moved(offset_m)))
    assert worsens(acting, simulation, recorded, np.random.default_rng(0)) is (expected and not elsewhere)


def test_a_simulation_that_is_a_model_has_no_readings_to_worsen():
    acting = Transport(model_of(LOUD), model_of(moved(-0.03)))
    recorded = batch_of(moved(0.03), seed=1)
    assert not worsens(acting, Simulation(model_of(LOUD)), recorded, np.random.default_rng(0))
