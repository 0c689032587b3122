"""A correction is offered where it beats the simulation, and nothing is offered where it is the simulation."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from noise.discrepancy.baseline.forest import grown
from noise.discrepancy.baseline.sources import Baseline
from noise.discrepancy.judge.correction import Option, Options, gains, offered, option_of
from noise.discrepancy.judge.held_out import Simulation, crps_of_each, log_score
from noise.discrepancy.name.folds import Folds
from noise.discrepancy.name.search import Search
from noise.fitting.stack import LEVEL_SD
from tests.noise.discrepancy.made import batch_of, law_of, model_of

LOUD = {"sensitivity": {"loss_db": 0.0}}
MOVED = {**LOUD, "zero_offset": {"offset_m": 0.03}}
WITHOUT = model_of(LOUD)


def options(forest, gain, **named):
    """Return options of which all but the named ones do not exist."""
    none = dict.fromkeys(("with_causes", "with_term", "on_simulation", "with_both"))
    return Options(**none | named, forest=forest, causes_gain=gain, without=WITHOUT, shared=WITHOUT)


def option(model, *batches):
    return option_of([model] * len(batches), batches)


@pytest.fixture(scope="module")
def parts():
    """Recorded visits that nothing was fitted to, others, and a forest of these."""
    unseen, seen = batch_of(MOVED, seed=1), batch_of(MOVED, seed=2)
    forest = grown(seen, np.random.default_rng(0))

    def score(tolerance):
        return (unseen, crps_of_each(forest.model, unseen, tolerance)), (seen, forest.crps_within(tolerance))

    return unseen, seen, Option(forest.model, score)


def test_the_law_that_made_the_readings_is_offered(parts):
    unseen, seen, forest = parts
    laws = (option(model_of(MOVED), unseen, seen), option(model_of(LOUD), unseen, seen))
    assert (
        options(forest, True, with_causes=laws[0], with_term=laws[1]).corrected(Simulation(model_of(LOUD)))
        is laws[0].model
    )


def test_nothing_beats_a_simulation_that_is_right(parts):
    unseen, seen, forest = parts
    law = option(model_of({**MOVED, "zero_offset": {"offset_m": 0.032}}), unseen, seen)
    assert options(forest, True, with_causes=law).corrected(Simulation(model_of(MOVED))) is None


@pytest.mark.parametrize("certain", [True, False])
def test_a_gain_too_small_for_the_crps_counts_where_the_log_score_is_certain_of_it(parts, certain):
    seen, forest = parts[1], parts[2]
    before = Simulation(model_of({**MOVED, "zero_offset": {"offset_m": 0.0285}}))
    few = seen.thin(12)
    law = option(model_of(MOVED), few)
    assert before.gain(*law.scored).sum() > 0.0
    assert not before.is_beaten(*law.scored)
    worse = Option(forest.model, lambda tolerance: tuple((batch, 2.0 * crps) for batch, crps in law.score(tolerance)))
    found = options(worse, certain, with_causes=law).corrected(before)
    assert found is (law.model if certain else None)


def test_a_few_missed_echoes_do_not_hide_a_correction_that_is_certain(parts):
    """A missed echo counts metres in the CRPS: the sum over few visits may have any sign."""
    before, law = Simulation(model_of(LOUD)), option(model_of(MOVED), parts[1])
    (batch, crps), forest = law.scored[0], parts[2]
    missed = np.where(np.arange(len(batch)) == 0, 1.1 * (before.gain(*law.scored).sum() + crps[0]), crps)
    unlucky = Option(law.model, lambda tolerance: ((batch, missed),) if tolerance is None else law.score(tolerance))
    assert before.gain(*unlucky.scored).sum() < 0.0
    worse = Option(forest.model, lambda tolerance: tuple((b, 2.0 * each) for b, each in unlucky.score(tolerance)))
    assert options(worse, True, with_causes=unlucky).corrected(before) is law.model
    assert options(worse, False, with_causes=unlucky).corrected(before) is None


@pytest.mark.parametrize(("offset_m", "offered_"), [(0.03, True), (-0.03, False)])
def test_what_a_model_misses_of_the_simulation_does_not_hide_causes_that_surely_gain_on_it(parts, offset_m, offered_):
    """Both the model and the causes on it miss the same, however uncertain it is how much that is."""
    seen, forest = parts[1], parts[2]
    before = Simulation(model_of(LOUD), excess=(0.0, 10.0))
    on_it = option(model_of({**MOVED, "zero_offset": {"offset_m": offset_m}}), seen)
    assert not before.is_beaten(*on_it.scored)
    worse = Option(forest.model, lambda tolerance: tuple((b, 2.0 * crps) for b, crps in forest.score(tolerance)[1:]))
    found = options(worse, False, on_simulation=on_it).corrected(before)
    assert found is (on_it.model if offered_ else None)


@pytest.mark.parametrize(("error_m", "offered_"), [(0.0, False), (10.0, True)])
def test_an_uncertain_score_of_the_simulation_does_not_make_a_certain_correction_worse(parts, error_m, offered_):
    """What the model misses of the simulation may be estimated from few missed echoes, and exceed all it has."""
    seen, forest = parts[1], parts[2]
    law = option(model_of(MOVED), seen)
    before = Simulation(model_of(LOUD), excess=(0.5, error_m))
    assert before.gain(*law.scored).sum() < 0.0
    worse = Option(forest.model, lambda tolerance: tuple((b, 2.0 * crps) for b, crps in forest.score(tolerance)[1:]))
    found = options(worse, True, with_causes=law).corrected(before)
    assert found is (law.model if offered_ else None)


def test_a_term_that_mends_the_emulator_alone_is_not_offered(parts):
    """It predicts better beyond chance than the law that it corrects, and no better than what is known to be so."""
    unseen, seen, forest = parts
    term = option(model_of(MOVED), unseen, seen)
    assert term.beats(lambda _: model_of({**MOVED, "zero_offset": {"offset_m": 0.1}}))
    worse = Option(forest.model, lambda tolerance: tuple((b, 2.0 * each) for b, each in term.score(tolerance)))
    found = [
        options(worse, False, with_term=term).corrected(Simulation(model)) for model in (term.model, model_of(LOUD))
    ]
    assert found == [None, term.model]


@pytest.mark.parametrize(("offset_m", "better"), [(0.03, True), (-0.03, False)])
def test_two_visits_suffice_to_apply_a_cause_that_predicts_them_better(parts, offset_m, better):
    """Between two visits no test reaches 5 %: the probability of the cause says that the gain is no chance."""
    seen = parts[1]
    two = seen.select(seen.visit < 2)
    models = model_of({**LOUD, "zero_offset": {"offset_m": offset_m}}), model_of(LOUD)
    law, emulator = (replace(option(each, two), nats=(log_score(each, two),)) for each in models)
    assert gains(law, emulator) is better


def test_what_rests_on_a_forest_is_preferred_to_a_law_only_where_it_is_better_beyond_chance(parts):
    seen, forest = parts[1], parts[2]
    law = option(model_of({**MOVED, "zero_offset": {"offset_m": 0.031}}), seen)
    before = Simulation(model_of(LOUD))

    def scaled(factor):
        """Return a forest with a multiple of the law's scores, which differs from visit to visit."""

        def score(tolerance):
            return tuple((b, factor * each + _uneven(b)) for b, each in law.score(tolerance))

        return Option(forest.model, score)

    found = [options(scaled(factor), True, with_causes=law).corrected(before) for factor in (0.999, 0.5)]
    assert found == [law.model, forest.model]


def _uneven(batch):
    return 1e-4 * np.where(np.arange(batch.n_visits) % 2, 1.0, -1.0)[batch.visit]


def test_without_a_law_the_forest_is_offered(parts):
    forest = parts[2]
    assert options(forest, False).corrected(Simulation(model_of(LOUD))) is forest.model


def test_the_law_without_causes_has_all_else_as_the_recording_has_it():
    """So that where a target begins to be heard is the same in both, and readings carried between them are not lost."""
    batch, rng = batch_of(MOVED, seed=1), np.random.default_rng(0)
    search = Search(law_of(), Folds.of(batch, rng), None, rng)
    stack = search.common.at({("zero_offset", "offset_m"): 0.03, LEVEL_SD: 6.0})
    one = SimpleNamespace(stack=stack)
    judged = SimpleNamespace(
        believed=("zero_offset",), final=SimpleNamespace(single=one), found=SimpleNamespace(stacks=(stack, stack))
    )
    before = Simulation(model_of(LOUD))
    base = Baseline(law_of(), None, model_of(LOUD), model_of(LOUD), None)
    found = Options.of(judged, search, grown(search.folds.both, rng), before, base, 0.001, None)
    law, without = (each.law(batch.ping) for each in (found.causes_only, found.without))
    np.testing.assert_array_equal(without.echo, law.echo)
    heard = law.echo > 0.5
    np.testing.assert_allclose((law.quantile(0.5) - without.quantile(0.5))[heard], 0.03, atol=0.0011)


def test_an_offered_law_has_the_coarser_register():
    assert offered(law_of(), 0.01).resolution == 0.01
    assert offered(law_of(), 0.0001).resolution == law_of().resolution
