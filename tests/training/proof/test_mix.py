"""Trials are what they claim: drawn from their secret alone, of every kind, on a ladder of sizes."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from acquisition import Recording
from noise.effects import CATALOGUE
from training.proof.generate import generated, generator
from training.proof.seal import hash_of_file
from training.proof.trials import causes, strangers
from training.proof.trials.mix import (
    DECK,
    FAMILY,
    HIDEABLE,
    MATCHED,
    NULL,
    PAIR,
    STRANGER,
    card_of,
    effect_trial,
    make,
    stranger_trial,
)
from training.proof.trials.surveys import Design


def block(number: int) -> np.random.Generator:
    return generator("deck", f"block {number}")


def test_a_deck_holds_enough_of_what_must_not_be_named():
    share = Counter(DECK)
    assert share[NULL] >= 0.2 * len(DECK)
    assert share[STRANGER] >= 0.3 * len(DECK)


def test_every_deck_is_whole_and_the_number_of_a_trial_tells_nothing():
    decks = [[card_of(25 * deck + k, "mixed", block)[0] for k in range(25)] for deck in range(3)]
    assert all(Counter(deck) == Counter(DECK) for deck in decks)
    assert decks[0] != decks[1] != decks[2]


@pytest.mark.parametrize("kind", [NULL, PAIR, STRANGER, FAMILY])
def test_the_same_secret_makes_the_same_files_and_answer(tmp_path, kind):
    asked = [{"trial": 3, "secret": "s", "kind": kind, "folder": str(tmp_path / name)} for name in "ab"]
    first, second = (generated(each) for each in asked)
    assert first == second
    assert first["files"]["recorded.csv"] == hash_of_file(tmp_path / "a" / "recorded.csv")
    assert generated({**asked[0], "secret": "t"})["files"] != first["files"]


@pytest.mark.parametrize("name", causes.BY_NAME)
def test_every_cause_is_of_the_catalogue_and_changes_the_readings(name):
    trial = effect_trial(np.random.default_rng(1), name)
    told = trial.answer["causes"][0]
    assert set(told["accepted"]) <= set(CATALOGUE)
    _differs_and_tells_nothing(trial.simulated, trial.recorded)


@pytest.mark.parametrize("name", strangers.BY_NAME)
def test_every_stranger_is_outside_the_catalogue(name):
    trial = stranger_trial(np.random.default_rng(2), name)
    assert name.replace(" ", "_") not in CATALOGUE
    _differs_and_tells_nothing(trial.simulated, trial.recorded)


def _differs_and_tells_nothing(simulated: Recording, recorded: Recording) -> None:
    columns = set(simulated.table.columns)
    assert columns == set(recorded.table.columns)
    assert not columns & {"temperature_c", "humidity_pct", "gain", "range_mm", "effect", "cause"}
    assert simulated.name == recorded.name
    assert np.mean(recorded.reading.answered) > 0
    assert len(simulated) >= 400


def test_there_are_enough_kinds():
    assert len(causes.CAUSES) >= 25
    assert len(strangers.STRANGERS) >= 10
    assert set(HIDEABLE) <= set(causes.BY_NAME)


def test_matched_marginals_agree_although_an_effect_is_at_work():
    answers = [make(MATCHED, np.random.default_rng(seed)).answer for seed in range(4)]
    assert np.median([a["marginals"]["ks_p"] for a in answers]) > 0.2
    assert np.median([abs(a["marginals"]["mean_mm"]) for a in answers]) < 60.0
    assert np.median([abs(np.log(a["marginals"]["sd_ratio"])) for a in answers]) < 0.1


def test_null_recordings_have_scatter_and_other_conditions():
    trials = [make(NULL, np.random.default_rng(seed)) for seed in (3, 4, 5)]
    assert all(trial.answer["causes"] == [] for trial in trials)
    assert len({trial.answer["same_grid"] for trial in trials}) == 2
    assert not any(np.array_equal(t.simulated.reading.range, t.recorded.reading.range) for t in trials)


def test_a_survey_visits_each_condition_once_in_an_order_of_its_own():
    design, rng = Design(cells=12, pings=5, runs=3), np.random.default_rng(0)
    ping = design.survey(design.conditions(rng), rng)
    assert len(ping) == 60
    assert len(np.unique(ping.run)) == 3
    assert np.all(np.diff(ping.time) > 0)
    assert np.corrcoef(ping.distance, ping.time)[0, 1] < 0.6
