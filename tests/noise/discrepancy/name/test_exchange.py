"""What forward selection is too greedy for is exchanged."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from noise.discrepancy.name.common import in_simulation
from noise.discrepancy.name.exchange import exchanged, in_both, promising, sufficient
from noise.discrepancy.name.hypothesis import Hypothesis
from tests.noise.discrepancy.made import batch_of, search_of

VISITS = 40
NONE = Hypothesis((), ("law",), np.zeros(VISITS))


def gaining(name, nats, seed=0):
    """Return an effect that gains so much, in visits of its own."""
    gain = np.zeros(VISITS)
    gain[np.random.default_rng(seed).choice(VISITS, VISITS // 2, replace=False)] = nats / (VISITS // 2)
    return Hypothesis((name,), (f"law with {name}",), gain)


@dataclass
class Rounds:
    """A first round of effects with p-values of what each leaves; two effects gain the sum together."""

    effects: list
    p: dict = field(default_factory=dict)
    unexplained: tuple = ()
    common = "common"

    def __post_init__(self):
        self.rng = np.random.default_rng(1)
        self.tried = {(): {each.effects[0]: each for each in self.effects}}
        self.base = {(): (self.common, NONE)}

    def explains(self, found, name):
        return name not in self.unexplained

    def is_left(self, found, level):
        return self.p[found.effects[-1]] < level

    def keys(self, effects):
        return tuple(effects)


@pytest.mark.parametrize(
    ("p", "end"),
    [
        ({"first": 0.001, "second": 0.5}, "second"),  # one cause that leaves nothing
        ({"first": 0.2, "second": 0.5}, "first"),  # it leaves nothing itself
        ({"first": 0.001, "second": 0.05}, "first"),  # both leave something
    ],
)
def test_a_probable_effect_that_leaves_nothing_is_preferred_to_the_likeliest_that_leaves_something(p, end):
    first, second = gaining("first", 20.0), gaining("second", 18.5)
    assert sufficient(Rounds([first, second], p), first, NONE).effects == (end,)


def test_an_effect_that_hardly_predicts_replaces_none_whatever_the_test_says():
    first, second = gaining("first", 20.0), gaining("second", 8.0)
    assert sufficient(Rounds([first, second], {"first": 0.001, "second": 0.9}), first, NONE) is first


def test_an_effect_that_explains_nothing_replaces_none():
    first, second = gaining("first", 20.0), gaining("second", 19.0)
    rounds = Rounds([first, second], {"first": 0.001, "second": 0.9}, unexplained=("second",))
    assert sufficient(rounds, first, NONE) is first


def test_pairs_whose_gains_exceed_what_two_effects_gained_are_promising_unless_they_gain_alike():
    one, other, twin = gaining("one", 30.0), gaining("other", 25.0, seed=2), gaining("twin", 28.0)
    rounds = Rounds([one, other, twin])
    assert promising(rounds, (), 40.0) == [("one", "other"), ("other", "twin")]
    assert promising(rounds, (), 54.0) == [("one", "other")]
    assert promising(rounds, ("one",), 40.0) == []  # a round that was not


def test_a_single_effect_is_exchanged_for_no_pair():
    one = gaining("one", 30.0)
    assert exchanged(Rounds([one, gaining("other", 25.0, seed=2)]), one) is one


SPIKES = {"spike": {"probability": 0.015}}


@pytest.mark.parametrize(
    ("simulation", "offset_m", "visits", "both"),
    [
        (SPIKES, 0.002, 16, True),  # of few readings, so that its spikes are not beyond chance
        (None, 0.002, 250, False),  # of many readings without a spike
        (SPIKES, 0.0, 16, False),  # nothing else differs
    ],
)
def test_what_two_files_may_have_alike_is_no_difference_where_another_effect_describes_both_better(
    simulation, offset_m, visits, both
):
    simulated = batch_of(simulation, 9 if simulation is None else 8, visits=visits, pings=6)
    search = search_of({**SPIKES, "zero_offset": {"offset_m": offset_m}}, simulated=simulated)
    none = search.null()
    starts = {"spike": {("spike", "probability"): 0.02}, "zero_offset": {("zero_offset", "offset_m"): 0.002}}
    tried = {name: search.crossed(none.stacks[0].at(start), none, (name,), False) for name, start in starts.items()}
    assert tried["spike"].value > tried["zero_offset"].value + search.least_gain
    assert in_simulation(search.common, search.keys(["spike"]), tried["spike"].stacks, simulated)[1] < search.least_gain
    assert (in_both(search, tried, "spike") is not None) == both
