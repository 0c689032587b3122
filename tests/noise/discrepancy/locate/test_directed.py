"""Where the law is known exactly, readings drawn from it stand for the simulation's: alike in all that visits share."""

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise.discrepancy.locate.directed import directed_test
from noise.discrepancy.moments.bootstrap import signs_of
from noise.discrepancy.moments.sample import Sample
from noise.discrepancy.moments.scores import with_own_placement
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import simulate
from noise.physical import PhysicalModel

JITTER = CATALOGUE["travel_time_jitter"](sigma_m=0.002)
REPEATS = CATALOGUE["stale_repeat"](probability=0.2)
VISITS, PINGS = 80, 10


def p_value(seed, effects=(JITTER,), placement=0.003, alternating=False, truth=None, known=None):
    """Return the p-value of readings of a law, or of other effects, of targets that are placed once per visit."""
    law, rng = PhysicalModel(effects), np.random.default_rng([seed, 0])
    distance = 0.4 + 0.001 * rng.choice(2100, VISITS, replace=False)
    placed = distance + rng.normal(0.0, placement, VISITS)
    visit = np.repeat(np.arange(VISITS), PINGS)
    if alternating:  # between two positions
        visit = visit.reshape(-1, 2, PINGS).swapaxes(1, 2).ravel()
    time = np.arange(len(visit)) * 1.0
    model = law if truth is None else PhysicalModel(truth)
    reading = simulate(model, Ping.of(placed[visit], time=time), rng)
    batch = Batch.of(Recording.of(Ping.of(distance[visit], time=time), reading))
    sample = Sample.comparable(batch, None)
    own, _ = with_own_placement(Stack.of(law), sample)
    signs = signs_of(sample.cluster, np.random.default_rng([seed, 1]))
    beside = None if known is None else own.at(known)
    return directed_test(own, sample, signs, np.random.default_rng([seed, 2]), beside=beside).p_value.value


@pytest.mark.parametrize("alternating", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_the_placement_of_a_visit_is_no_difference(seed, alternating):
    assert p_value(seed, alternating=alternating) > 0.01


@pytest.mark.parametrize("placement", [0.0, 0.003])
@pytest.mark.parametrize("seed", range(2))
def test_a_law_that_repeats_readings_is_that_of_readings_that_it_repeats(seed, placement):
    assert p_value(seed, (JITTER, REPEATS), placement) > 0.01


def test_repeated_readings_and_an_offset_are_found():
    assert p_value(0, truth=(JITTER, REPEATS)) < 0.01
    assert p_value(0, truth=(JITTER, CATALOGUE["zero_offset"](offset_m=0.01))) < 0.01


def test_beside_a_known_offset_only_what_else_differs_is_found():
    offset, known = CATALOGUE["zero_offset"](offset_m=0.01), {("zero_offset", "offset_m"): 0.01}
    assert p_value(0, truth=(JITTER, offset), known=known) > 0.01
    assert p_value(0, truth=(JITTER, REPEATS, offset), known=known) < 0.01
