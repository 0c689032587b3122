"""The table can come out well and badly, and its figures are those that can be reckoned by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from training.proof.scoring.figure import accuracy
from training.proof.scoring.page import page
from training.proof.scoring.score import Scored, by_separation, confusion, covered, overlap, table, trials_of
from training.proof.scoring.settled import against_anywhere, is_settled, lines

TARGETS = 18


def effect(name: str, alike: tuple[str, ...] = (), **parameters: tuple[float, float, float]) -> dict[str, Any]:
    told = {key: {"value": v, "low": low, "high": high, "unit": "1"} for key, (low, v, high) in parameters.items()}
    return {"effect": name, "indistinguishable_from": list(alike), "probability": 1.0, "parameters": told}


def trial(kind: str, said: str = "none", nats: float = 100.0, **given: Any) -> Scored:
    """Return an opened trial, of a concealed clock error unless told otherwise."""
    truth = [] if kind == "null" else given.get("causes", [{"name": "clock_scale", "accepted": ["clock_scale"]}])
    verdict = {
        "verdict": said,
        "effects": given.get("effects", []),
        "where": given.get("where", []),
        "p_value": given.get("p", 0.9),
        "held_out": {"after": {"log_likelihood_per_ping": given.get("after", 1.0)}},
        "next_measurement": given.get("asked", []),
        "next_settings": given.get("settings", given.get("asked", [])),
    }
    scores = {
        "separation_nats": nats,
        "least_nats": nats,
        "vault_before": 0.0,
        "vault_oracle": 1.0,
        "oracle_widths": {},
    }
    scores |= {"classifier_z": 0.0, "classifier_nats": 0.0, "kernel_p": 1.0} | given.get("scores", {})
    return Scored(
        {"kind": kind, "causes": truth, **given.get("answer", {})}, verdict, scores, given.get("seconds", 10.0)
    )


def line(trials: list[Scored], metric: str) -> Any:
    found = [each for each in table(trials) if each.metric.startswith(metric)]
    assert len(found) == 1
    return found[0]


def test_every_target_of_the_design_has_its_line_even_without_trials():
    assert len(table([])) == TARGETS
    assert all(each.met is None and each.trials == 0 for each in table([]))


def test_false_alarms_are_counted_with_wilson_limits():
    trials = [trial("null")] * 48 + [trial("null", "named", effects=[effect("spike")])] * 2
    told = line(trials, "null: an effect named")
    limits = binomtest(2, 50).proportion_ci(0.95, "wilson")
    assert (told.value, told.low, told.high, told.trials, told.met) == (0.04, limits.low, limits.high, 50, False)


def test_a_few_trials_may_miss_a_target_but_never_meet_one():
    good, bad = trial("null"), trial("null", "named", effects=[effect("spike")])
    assert line([good] * 5, "null: an effect named").met is None
    assert line([good] * 5 + [bad], "null: an effect named").met is False
    assert line([good] * 60, "null: an effect named").met is True


def test_a_name_is_right_also_within_a_confounded_set():
    named = trial("effect", "named", effects=[effect("clock_scale")])
    confounded = trial("effect", "confounded", effects=[effect("sound_speed", ("clock_scale",))])
    wrong = trial("effect", "named", effects=[effect("zero_offset")])
    assert [t.right for t in (named, confounded, wrong)] == [True, True, False]
    assert line([named, confounded, wrong, wrong], "right class").value == 0.5


def test_of_a_pair_both_must_be_named():
    causes = [{"name": n, "accepted": [n]} for n in ("clock_scale", "spike")]
    both = trial("pair", "named", causes=causes, effects=[effect("spike"), effect("clock_scale")])
    one = trial("pair", "named", causes=causes, effects=[effect("spike")])
    assert line([both, one], "pairs").value == 0.5
    assert line([trial("pair", nats=10.0, causes=causes)], "pairs").trials == 0


def test_a_stranger_that_gets_a_name_is_wrong_whatever_the_name():
    causes = [{"name": "swaying target"}]
    good = trial("stranger", "unknown", causes=causes)
    bad = trial("stranger", "named_with_rest", causes=causes, effects=[effect("spike")])
    weak = trial("stranger", "none", nats=3.0, causes=causes)
    assert line([good, bad, weak], "stranger, ≥ 15 nats: unknown").value == 0.5
    assert line([good, bad, weak], "stranger, ≥ 15 nats: a wrong name").value == 0.5


def test_what_cannot_be_told_may_stay_unsaid_but_not_be_named_alone():
    silent = trial("effect", "none", nats=0.5)
    alone = trial("effect", "named", nats=0.5, effects=[effect("spike")])
    careful = trial("effect", "confounded", nats=0.5, effects=[effect("spike", ("clock_scale",))])
    assert line([silent, alone, careful], "< 2 nats: a lone name").value == pytest.approx(1 / 3)
    assert line([silent, alone, careful], "< 2 nats: the set").value == pytest.approx(2 / 3)


def test_intervals_are_held_against_the_known_value():
    cause = {"name": "clock_scale", "accepted": ["clock_scale"], "parameter": "error", "value": 0.01}
    hit = trial("effect", "named", causes=[cause], effects=[effect("clock_scale", error=(0.009, 0.010, 0.012))])
    miss = trial("effect", "named", causes=[cause], effects=[effect("clock_scale", error=(0.011, 0.012, 0.013))])
    assert covered([hit, miss, miss]) == [True, False, False]


def test_the_gap_that_is_closed_is_a_share_of_the_oracles():
    trials = [trial("effect", "named", effects=[effect("clock_scale")], after=a) for a in (0.5, 0.9, 1.0)]
    assert line(trials, "vault gap closed, median").value == pytest.approx(0.9)
    without = trial("effect", scores={"vault_oracle": 0.0})
    assert np.isnan(without.closed)


def test_regions_overlap_as_intervals_do():
    cause = {"name": "x", "accepted": ["x"], "region": {"distance_mm": [1000.0, 3000.0]}}
    where = [{"aspect": "bias", "region": {"distance_mm": [2000.0, 4000.0]}}]
    assert overlap(trial("effect", causes=[cause], where=where)) == pytest.approx(1 / 3)
    assert overlap(trial("effect", causes=[cause], where=[{"aspect": "bias", "region": {}}])) == 0.0
    assert np.isnan(overlap(trial("effect")))


def test_uniform_p_values_pass_and_small_ones_do_not():
    even = [trial("null", p=2.0 * p) for p in (np.arange(40) + 0.5) / 40 if p < 0.5] + [trial("null", p=1.0)] * 20
    small = [trial("null", p=0.02)] * 40
    assert line(even, "null: p-values uniform").met
    assert not line(small, "null: p-values uniform").met
    assert not line(small, "null: located").met


def test_accuracy_is_told_by_separation():
    trials = [trial("effect", nats=1.0), trial("effect", "named", nats=20.0, effects=[effect("clock_scale")])]
    bands = by_separation(trials)
    assert [(band.words, band.trials, band.right) for band in bands] == [("< 2", 1, 0.0), ("15 to 50", 1, 1.0)]


def test_what_was_said_of_what():
    trials = [trial("null"), trial("effect", "named", effects=[effect("spike")]), trial("effect", "unknown")]
    assert confusion(trials) == {"nothing": {"none": 1}, "clock_scale": {"spike": 1, "unknown": 1}}


def test_the_page_says_first_what_falls_short():
    bad = trial("null", "named", effects=[effect("spike")])
    lines: list[dict[str, Any]] = [
        {"event": "begun", "settings": {"commit": "c", "protocol": "1", "seed": 0, "nonce": "n"}}
    ]
    lines += [{"event": "verdict", "trial": 0, "verdict": bad.verdict, "seconds": 12.0}]
    lines += [{"event": "opened", "trial": 0, "answer": bad.answer, "scores": bad.scores}]
    assert len(trials_of(lines)) == 1
    text = page(lines)
    assert text.index("What falls short") < text.index("## Targets")
    assert "null: an effect named: 100 %" in text


def test_the_picture_is_drawn_of_many_trials_and_of_none():
    trials = [trial("effect", "named", nats=n, effects=[effect("clock_scale")]) for n in (1.0, 3.0, 20.0, 200.0)]
    for each in (trials, []):
        assert accuracy(each).startswith(b"\x89PNG")


ALIKE = [effect("clock_scale", ("zero_offset",))]
ASKED = [{"do": "go to 2.5 m", "separates": ["clock_scale", "zero_offset"], "pings": 5, "conditions": [], "also": {}}]


def row(here, anywhere=1.0, observed=1.0, replaces="clock_scale", effect="zero_offset"):
    """Return what a measurement told of a pair."""
    return {
        "replaces": replaces,
        "effect": effect,
        "observed": observed,
        "pings": 5,
        "here": here,
        "anywhere": anywhere,
    }


def followed(*rows, **given):
    """Return a trial of a clock error that was confounded, and measured again."""
    return trial("effect", "confounded", effects=ALIKE, asked=ASKED, scores={"followed": list(rows)}, **given)


def test_a_pair_is_settled_where_the_truth_is_preferred_clearly():
    assert is_settled(followed(row(8.0)))
    assert not is_settled(followed(row(1.0)))
    assert not is_settled(followed(row(-8.0)))
    assert not is_settled(followed(row(8.0), row(0.0)))


def test_a_truth_in_the_rivals_place_is_preferred_by_the_other_sign():
    other = {"replaces": "zero_offset", "effect": "clock_scale"}
    assert is_settled(followed(row(-8.0, **other)))
    assert not is_settled(followed(row(8.0, **other)))


def test_a_pair_of_which_neither_is_true_says_nothing():
    assert is_settled(followed(row(8.0, replaces="spike", effect="stuck"))) is None


def test_what_no_measurement_tells_apart_is_not_settled():
    hopeless = [{**ASKED[0], "pings": 0}]
    assert is_settled(trial("effect", "confounded", effects=ALIKE, asked=hopeless)) is False


@pytest.mark.parametrize(("truth", "shown", "right"), [("sound_speed", 8.4, True), ("sound_speed", 0.0, False)])
def test_a_thermometer_decides_by_what_it_shows(truth, shown, right):
    asked = [
        {"do": "thermometer", "separates": ["sound_speed", "clock_scale"], "pings": 1, "expected": {"warmer_k": 8}}
    ]
    given = {"causes": [{"name": truth, "accepted": [truth]}], "answer": {"warmer_k": shown}, "asked": asked}
    alike = [effect("clock_scale", ("sound_speed",))]
    assert is_settled(trial("effect", "confounded", effects=alike, **given)) is right


def test_pings_count_against_as_many_anywhere():
    assert against_anywhere(followed(row(8.0, 2.0))) == [4.0]
    assert against_anywhere(followed(row(8.0, -2.0))) == [100.0]
    assert against_anywhere(followed(row(-8.0, -2.0))) == [0.0]


def test_the_lines_count_trials_that_hold_the_truth():
    wrong = followed(row(8.0), causes=[{"name": "spike", "accepted": ["spike"]}])
    settles, times = lines([followed(row(8.0)), followed(row(0.0)), wrong])
    assert (settles.value, settles.trials) == (0.5, 2)
    assert times.trials == 2


def test_what_a_stranger_was_taken_for_is_no_pair_to_settle():
    stranger = trial("stranger", "confounded", effects=ALIKE, asked=ASKED, causes=[{"name": "dead band"}])
    settles, times = lines([stranger, followed(row(8.0))])
    assert (settles.trials, times.trials) == (1, 1)
