"""Corrections are measured against the simulation's own readings, with a library's score."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scoringrules import crps_ensemble

from noise.discrepancy.baseline.forest import grown
from noise.discrepancy.baseline.sources import Baseline
from noise.discrepancy.judge.held_out import Simulation, crps_of_each, fair_crps, repeatability
from noise.discrepancy.locate.directed import drawn_in_visits
from noise.fitting.stack import VISITS, Stack
from tests.noise.discrepancy.made import batch_of, law_of, model_of

METRES = st.floats(0.0, 11.0)


@given(arrays(float, 5, elements=METRES), arrays(float, st.integers(2, 12), elements=METRES))
def test_the_score_of_an_ensemble_is_that_of_the_library(value, members):
    expected = crps_ensemble(value, np.tile(members, (len(value), 1)), estimator="fair")
    np.testing.assert_allclose(fair_crps(value, members), expected, atol=1e-9)


def test_a_wrong_model_of_a_simulation_does_not_speak_for_it_where_its_readings_do():
    loud = {"sensitivity": {"loss_db": 0.0}}  # no silence, which would count metres
    readings = batch_of(loud, seed=1)
    wrong = model_of({**loud, "zero_offset": {"offset_m": 0.09}})
    of_model = Simulation(wrong).crps_of_each(readings)
    of_readings = Simulation(wrong, readings).crps_of_each(readings)
    assert of_readings.mean() < 0.1 * of_model.mean()


def test_a_model_speaks_for_a_simulation_where_it_has_no_readings():
    recorded, elsewhere = batch_of({}, seed=1), batch_of({}, seed=2)
    model = model_of()
    alone = Simulation(model).crps_of_each(recorded)
    np.testing.assert_array_equal(Simulation(model, elsewhere).crps_of_each(recorded), alone)


@given(arrays(float, st.integers(2, 12), elements=METRES))
def test_repeatability_is_the_mean_score_of_each_reading_by_the_others(value):
    others = np.array([np.delete(value, k) for k in range(len(value))])
    if len(value) == 2:  # the spread of a single other reading is unknown; its expectation is that of the pair
        expected = abs(value[0] - value[1]) / 2.0
    else:
        expected = crps_ensemble(value, others, estimator="fair").mean()
    assert repeatability(value) == pytest.approx(expected, abs=1e-9)


def test_what_a_model_misses_of_a_simulation_is_not_held_against_it():
    readings, elsewhere = batch_of({}, seed=1), batch_of({}, seed=2)
    crude = Simulation(model_of({"zero_offset": {"offset_m": 0.05}}), readings, (0.05, 0.0))
    assert not crude.is_beaten((elsewhere, crps_of_each(model_of(), elsewhere)))
    assert Simulation(crude.model, readings).is_beaten((elsewhere, crps_of_each(model_of(), elsewhere)))


def test_that_model_of_a_simulation_stands_for_it_which_predicts_the_recording_better():
    """A forest of few places knows less of other places than the law that made the readings."""
    readings, recorded = batch_of({}, seed=1), batch_of({}, seed=2)
    rng = np.random.default_rng(0)
    held_out = readings.select(readings.condition % 5 == 0)
    forest, law, wrong = grown(readings, rng), model_of(), model_of({"sensitivity": {"loss_db": 70.0}})
    for emulator, expected in ((law, law), (wrong, forest.model)):
        base = Baseline(law_of(), readings, forest.model, emulator, held_out, forest)
        assert Simulation.of(base, recorded, rng).model is expected


def test_what_the_readings_of_a_visit_share_is_no_error_of_the_law():
    """They predict each other better by millimetres than the very law does that they are drawn from."""
    loud = {"sensitivity": {"loss_db": 0.0}}
    careless = Stack.of(model_of(loud)).put([(VISITS, "placement_m")], [0.01])
    rng, model = np.random.default_rng(0), careless.single_ping_model
    readings, recorded = (drawn_in_visits(careless, batch_of(loud, seed=seed, visits=200), rng) for seed in (1, 2))
    forest = grown(readings, rng)
    by_others = np.mean([repeatability(readings.error[rows]) for rows in readings.visit_rows])
    assert crps_of_each(model, readings).mean() - by_others > 0.004
    found = Simulation.of(Baseline(careless, readings, forest.model, model, readings, forest), recorded, rng)
    assert found.excess[0] < 0.001


def test_how_little_is_known_of_a_model_does_not_matter_where_readings_speak():
    loud = {"sensitivity": {"loss_db": 0.0}}
    readings, elsewhere = batch_of(loud, seed=1), batch_of(loud, seed=2)
    moved = {**loud, "zero_offset": {"offset_m": 0.03}}
    recorded = batch_of(moved, seed=1)  # under the same conditions
    unsure = Simulation(model_of(loud), readings, (0.0, 10.0))
    assert unsure.is_beaten((recorded, crps_of_each(model_of(moved), recorded)))
    assert not Simulation(model_of(loud), elsewhere, (0.0, 10.0)).is_beaten(
        (recorded, crps_of_each(model_of(moved), recorded))
    )


def test_two_visits_that_gain_unequally_are_no_evidence():
    """A mean of two values is known to 6.3 of its standard errors at 95 %, not to 1.6."""
    loud = {"sensitivity": {"loss_db": 0.0}}
    two, twenty = (batch_of(loud, seed=1, visits=n) for n in (2, 20))
    for batch, expected in ((two, False), (twenty, True)):
        before = Simulation(model_of(loud))
        gain = np.where(batch.visit % 2 == 0, 0.001, 0.003)
        assert before.is_beaten((batch, before.crps_of_each(batch) - gain)) is expected


class Asked:
    """A model that counts how often it is asked."""

    resolution, remembers = 0.001, False

    def __init__(self):
        self.model, self.times = model_of(), 0

    def law(self, ping, past=None):
        self.times += 1
        return self.model.law(ping, past)


def test_a_model_is_asked_once_and_only_where_readings_do_not_speak():
    readings, elsewhere = batch_of({}, seed=1), batch_of({}, seed=2)
    simulation, asked = Simulation(Asked(), readings), []
    for batch in (readings, elsewhere):
        for _ in range(2):
            simulation.is_beaten((batch, np.zeros(len(batch))))
            simulation.near.gain((batch, np.zeros(len(batch))))
            assert simulation.gain_on(simulation, batch).sum() == 0.0
        asked.append((simulation.has_any_of(batch), simulation.model.times))
    assert asked == [(True, 0), (False, 2)]  # with and without a tolerance


def test_readings_speak_for_their_own_conditions_and_the_model_for_others():
    recorded, model = batch_of({}, seed=1), model_of()
    known = recorded.condition % 2 == 0
    both = Simulation(model, recorded.select(known), (0.001, 0.0))
    expected = np.where(
        known, Simulation(model, recorded).crps_of_each(recorded), crps_of_each(model, recorded) - both.excess[0]
    )
    np.testing.assert_allclose(both.crps_of_each(recorded), expected, atol=1e-12)
    gain = both.gain_on(Simulation(model, recorded), recorded)
    np.testing.assert_allclose(gain, 0.0, atol=1e-12)
