"""Two effects that cancel in the mean: alone neither gains anything, together they are plain."""

from itertools import combinations

import numpy as np
import pytest
import torch

from acquisition import Ping, Reading, Recording
from noise.discrepancy import diagnose
from noise.discrepancy.common.splits import Split
from noise.discrepancy.name.pairs import best_pair, promising, shifts, with_pairs
from noise.discrepancy.name.search import Search
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import VISITS, Stack
from noise.model import simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)
SHARES = {"clock_scale", "sound_speed", "thermal_drift", "time_walk"}  # that lengthen by a share of distance, or nearly
CONSTANTS = {"zero_offset", "warm_up"}


def sonar(**effects):
    usual = {"travel_time_jitter": {"sigma_m": 0.004}, "sensitivity": {"loss_db": 35.0}}
    return PhysicalModel([CATALOGUE[name](**values) for name, values in {**usual, **effects}.items()])


def heard(seed, cells=80, **effects):
    """Return a survey whose targets were put down within 3 mm."""
    rng = np.random.default_rng(seed)
    distance, angle = (np.repeat(rng.uniform(low, high, cells), 5) for low, high in ((0.3, 4.0), (-0.3, 0.5)))
    time, offset = np.arange(len(distance)) * 0.1, np.repeat(rng.normal(0, 0.003, cells), 5)
    reading = simulate(sonar(**effects), Ping.of(distance=distance + offset, angle=angle, time=time), rng)
    return Recording.of(Ping.of(distance=distance, angle=angle, time=time), reading)


def cancelling(share, seed):
    """Return a survey with a clock that is fast and a zero that is short, by nothing on the mean."""
    return heard(seed, clock_scale={"error": share}, zero_offset={"offset_m": -2.15 * share})


def searched(recording):
    split = Split.of(Batch.of(recording), np.random.default_rng(1))
    base = Stack.of(sonar()).put([(VISITS, "placement_m")], [0.003])
    return Search(base, split.discover, split.confirm, split.both)


def found(recording, known=()):
    search = searched(recording)
    return promising(shifts(search, search.base, []), known)


@pytest.mark.parametrize("seed", range(4))
def test_a_pair_that_cancels_promises_most_at_its_size(seed):
    search = searched(cancelling(0.01, seed))
    seen = shifts(search, search.base, [])
    best = promising(seen)[0]
    assert len(set(best.names) & SHARES) == 1
    assert len(set(best.names) & CONSTANTS) == 1
    start = seen.applied(search.base, best)
    law = start.expected(search.both) - search.both.ping.distance
    planted = 0.01 * search.both.ping.distance - 0.0215
    assert np.abs(law - planted).max() < 0.006


@pytest.mark.parametrize(
    "effects", [{}, {"clock_scale": {"error": 0.01}}, {"zero_offset": {"offset_m": 0.03}}], ids=lambda e: "".join(e)
)
def test_where_one_effect_or_none_is_enough_no_pair_promises(effects):
    # at a true rate of 3 %, three or more of twelve: p = 0.005
    assert sum(bool(found(heard(100 + seed, **effects))) for seed in range(12)) <= 2


def test_no_two_pairs_come_to_the_same_nor_to_what_is_tried_already():
    recording = cancelling(0.02, 3)
    pairs = found(recording)
    assert pairs
    for one, other in combinations(pairs, 2):
        assert np.linalg.norm(one.work - other.work) > 0.05 * np.linalg.norm(one.work)
    rest = found(recording, known=["sound_speed", "warm_up"])
    assert not any(set(p.names) & SHARES and set(p.names) & CONSTANTS for p in rest)
    assert found(recording, known=["zero_offset"]), "one alone, the same everywhere, does not come to what two do"


def test_where_nothing_is_off_by_a_digit_no_pair_promises():
    distance = np.repeat(np.linspace(0.4, 3.0, 60).round(2), 5)
    assert found(Recording.of(Ping.of(distance=distance), Reading.of(distance))) == []


def test_too_few_stays_tell_no_pair():
    search = searched(heard(1, cells=14))
    assert best_pair(search, [], search.cross(search.base, [])) is None


@pytest.mark.slow
def test_a_pair_takes_the_place_of_what_was_added_alone_and_is_written_down():
    search = searched(cancelling(0.008, 5))
    base = search.cross(search.base, [])
    chosen, current = with_pairs(search, [], base, base)
    assert len(set(chosen) & SHARES) == 1
    assert len(set(chosen) & CONSTANTS) == 1
    assert (current.nats - base.nats).sum() > 30.0
    told = [attempt for attempt in search.attempts if "pair" in attempt.decision]
    assert {(a.effect, *a.given) for a in told} >= {tuple(chosen), tuple(chosen[::-1])}


@pytest.mark.slow
@pytest.mark.parametrize(("share", "seed"), [(0.01, 7), (0.01, 8), (0.004, 7), (0.004, 8)])
def test_two_effects_that_cancel_in_the_mean_are_both_named(share, seed):
    verdict = diagnose(sonar(), cancelling(share, seed), seed=seed).to_verdict()
    assert verdict["verdict"] in ("named", "confounded")
    sets = [{e["effect"], *e["indistinguishable_from"]} for e in verdict["effects"]]
    assert len(sets) == 2
    assert any("clock_scale" in s for s in sets)
    assert any("zero_offset" in s for s in sets)
