"""Shares, probabilities and the verdict follow from their definitions."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import softmax

from acquisition import Reading, Recording
from noise.discrepancy.baseline.forest import grown
from noise.discrepancy.evidence import FEATURES, Evidence
from noise.discrepancy.judge.decision import decision_model
from noise.discrepancy.judge.judged import Judgement
from noise.discrepancy.judge.shares import Rest, pool_gain, shares
from noise.discrepancy.judge.verdict import kind_of, shows_little
from noise.discrepancy.name.alternatives import Place
from noise.discrepancy.name.folds import Folds
from noise.discrepancy.name.hypothesis import Hypothesis
from noise.discrepancy.name.search import Search
from noise.discrepancy.result import Cause, Interval, Kind, PValue, Unexplained, Visible
from noise.discrepancy.thresholds import BELIEVED
from noise.fitting.batch import Batch
from tests.noise.discrepancy.made import batch_of, law_of, recording_of

torch.set_num_threads(1)
STRONG = Evidence(300.0, 20.0, 1500, 100, 100.0, 10.0, 0.95, 0.05, 40.0, -0.5, 5e-4, 0.4, 0.6, 0.0, 1, False)
WEAK = Evidence(3.0, 4.0, 1500, 100, -30.0, 10.0, 0.05, 0.9, 0.1, -5.0, 0.009, 5e-4, 5e-4, 0.9, 3, True)
REST = Unexplained(Interval(0.1, 0.05, 0.2, "1"), PValue(0.001, 2000))
CAUSE = Cause("zero_offset", 0.9, (), Interval(0.9, 0.8, 1.0, "1"), 100.0, 10.0, {}, "")


def rest_of(search):
    return Rest(search, grown(search.joined, np.random.default_rng(5)), None)


def test_a_single_cause_explains_nearly_everything():
    batch = batch_of({"zero_offset": {"offset_m": 0.015}}, seed=4)
    search = Search(law_of(), Folds.of(batch, np.random.default_rng(4)), None, np.random.default_rng(4))
    none, found = search.run()
    divided = shares(
        Rest(search, grown(search.joined, np.random.default_rng(5)), None), none, found, np.random.default_rng(5)
    )
    share = divided.causes["zero_offset"]
    assert share.low <= share.value <= share.high
    assert share.value > 0.9
    assert divided.rest.value < 0.1
    gain, error = divided.gains["zero_offset"]
    assert gain > 4.0 * error > 0.0
    lead, error = divided.leads["zero_offset"]
    assert lead > 2.0 * error > 0.0


@dataclass
class Answer:
    """What a test says."""

    p: float

    def is_below(self, level):
        return self.p < level


class Tried(Judgement):
    """A judgement without fits, in which hypotheses have neighbours: `comparing` holds value and p-value of each."""

    def __post_init__(self):
        self.known[self.found] = self
        self.after = Answer(self.comparing[self.found.effects[0]][1])

    def places(self):
        own = self.found.effects[0]
        near = {name: value for name, (value, _) in self.comparing.items() if abs(ord(name) - ord(own)) < 2}
        likely = dict(zip(near, softmax(list(near.values())), strict=True))
        fits = {name: Hypothesis((name,), (), np.array([value])) for name, value in near.items()} | {own: self.found}
        return (self.tested(Place(own, likely, 0.0, fits)),)


def settled(values, refuted=""):
    """Return the effect that a search of named values ends at, and its place."""
    comparing = {name: (value, 0.001 if name in refuted else 0.5) for name, value in values.items()}
    selected, (place,) = Tried(comparing, Hypothesis(("a",), (), np.array([values["a"]]))).settled()
    return selected.found.effects[0], place


@pytest.mark.parametrize(
    ("values", "end"),
    [({"a": 0.0, "b": 5.0, "c": 20.0}, "c"), ({"a": 0.0, "b": -2.0, "c": 20.0}, "a"), ({"a": 9.0, "b": 2.0}, "a")],
)
def test_effects_are_exchanged_for_others_in_their_places_until_each_is_the_most_probable(values, end):
    found, place = settled(values)
    assert found == place.effect == end
    assert max(place.likely.values()) == place.likely[end]


def test_an_effect_that_the_test_refutes_gives_place_to_one_that_it_does_not():
    found, place = settled({"a": 2.0, "b": 0.0}, refuted="a")
    assert found == "b"
    assert place.likely == {"b": 1.0}


@pytest.mark.parametrize("refuted", ["", "ab"])
def test_a_test_that_refutes_all_or_none_decides_nothing(refuted):
    found, place = settled({"a": 2.0, "b": 0.0}, refuted)
    assert found == "a"
    assert place.likely["b"] == pytest.approx(1.0 / (1.0 + np.exp(2.0)))


class Turned(Tried):
    """A judgement in whose places another effect always leads."""

    def places(self):
        own, other = self.found.effects[0], "b" if self.found.effects == ("a",) else "a"
        fits = {own: self.found, other: Hypothesis((other,), (), np.zeros(1))}
        return (Place(own, {own: 0.4, other: 0.6}, 0.0, fits),)


def test_effects_that_lead_in_turn_end_a_search():
    selected, _ = Turned({"a": (0.0, 0.5), "b": (0.0, 0.5)}, Hypothesis(("a",), (), np.zeros(1))).settled()
    assert selected.found.effects == ("b",)


def test_an_effect_that_is_not_worth_listing_is_not_tested():
    found, place = settled({"a": 9.0, "b": 0.0}, refuted="a")
    assert found == "a"
    assert place.likely["a"] > 0.99


def test_most_of_a_misfit_that_the_effect_does_not_describe_is_the_rest():
    recording = recording_of(seed=3)
    reading, distance = recording.reading, recording.ping.distance
    bent = Reading.of(np.where(reading.echo, reading.range + 0.03 * np.sin(4.0 * distance), 0.0))
    batch = Batch.of(Recording.of(recording.ping, bent))
    search = Search(law_of(), Folds.of(batch, np.random.default_rng(4)), None, np.random.default_rng(4))
    none = search.null()
    start = none.stacks[0].put([("clock_scale", "error")], [0.005])
    wrong = search.crossed(start, none, ("clock_scale",), own_scatter=False)
    divided = shares(
        Rest(search, grown(search.joined, np.random.default_rng(5)), None), none, wrong, np.random.default_rng(5)
    )
    assert divided.rest.value > 0.5
    assert divided.leads["clock_scale"][0] < 0.0


def test_a_pool_gains_all_of_a_better_prediction_and_loses_nothing_to_a_worse_one():
    law = np.full(200, -3.0)
    assert np.isclose(pool_gain(law, law + 1.0).sum(), 200.0, rtol=1e-3)
    assert pool_gain(law, law - 1.0).sum() >= 0.0
    mixed = law + np.where(np.arange(200) % 2, 2.0, -2.0)
    half = np.log(0.5 + 0.5 * np.exp(mixed - law)).sum()
    assert pool_gain(law, mixed).sum() >= half - 1e-6


def test_every_feature_has_a_name_and_is_finite():
    for evidence in (STRONG, WEAK, replace(WEAK, lead=float("inf"), lead_unnamed=-5.0, lead_unnamed_error=0.0)):
        assert evidence.features().shape == (len(FEATURES),)
        assert np.isfinite(evidence.features()).all()


def test_strong_evidence_is_believed_and_weak_is_not():
    model = decision_model()
    assert model.probability(WEAK) < BELIEVED <= model.probability(STRONG)


@given(st.floats(0.0, 300.0), st.floats(0.0, 100.0))
def test_a_gain_that_repeats_itself_better_is_never_less_probable(gain, more):
    model = decision_model()
    for name in ("gain", "lead_unnamed"):
        least, most = (model.probability(replace(STRONG, **{name: value})) for value in (gain, gain + more))
        assert least <= most


@pytest.mark.parametrize(
    ("together", "p_after", "kind"),
    [
        (0.95, 0.0005, Kind.EXPLAINED),
        (0.5, 0.2, Kind.EXPLAINED),
        (0.5, 0.0005, Kind.PARTLY_EXPLAINED),
        (0.2, 0.0005, Kind.UNEXPLAINED),
    ],
)
def test_the_verdict_follows_from_share_and_test(together, p_after, kind):
    assert kind_of([CAUSE], together, replace(REST, p_value=PValue(p_after, 2000))) is kind


def test_without_a_cause_a_difference_is_unexplained():
    assert kind_of([], 0.0, REST) is Kind.UNEXPLAINED


def test_what_shows_nothing_plausible_is_too_little():
    assert shows_little([Visible("bias", 0.5, "m"), Visible("detection", 0.9, "1")])
    assert not shows_little([Visible("bias", 0.004, "m")])
    assert shows_little([])
