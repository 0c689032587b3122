"""Whether what could as well have been the cause is found, wherever the climb to it begins."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.signal import lfilter

from acquisition import Ping, Reading, Recording
from noise.discrepancy.common.rules import TIE
from noise.discrepancy.name.explanation import Explained, Final
from noise.discrepancy.name.rivals import SAME, Contest, Rival
from noise.discrepancy.name.search import Crossed, Search
from noise.fitting.batch import Batch
from noise.fitting.fit import maximise
from noise.fitting.stack import JITTER, NUISANCES, VISITS, Stack
from noise.fitting.starts import nuisance_start
from noise.model import simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)
OFFSET, CLOCK = ("zero_offset", "offset_m"), ("clock_scale", "error")
ELSEWHERE = {  # summits of what cells share that a climb may not come down from
    (VISITS, "urn_weight"): 0.0,
    (VISITS, "ping_correlation"): 0.6,
    (VISITS, "urn_width_m"): 0.02,
    (VISITS, "detection_weight"): 0.05,
    (VISITS, "placement_m"): 0.03,
    (JITTER, "sigma_m"): 0.02,
}


def survey(spread_m, seed=1):
    """Return 40 cells of 24 pings within a spread of distances, 12 mm too far, whose scatter hangs together."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(1.0 - spread_m, 1.0 + spread_m, 40), 24)
    air = lfilter([1.0], [1.0, -0.8], rng.normal(0.0, 0.002, (40, 24)), axis=1).ravel()
    off = 0.012 + np.repeat(rng.normal(0.0, 0.002, 40), 24) + air
    reading = simulate(PhysicalModel(()), Ping.of(distance=distance + off), rng)
    return Batch.of(Recording.of(Ping.of(distance=distance), Reading.of(np.round(reading.range / 0.003) * 0.003)))


def met(batch, replicas=True):
    """Return a wrong clock as it meets a shift, from a place far off; without replicas nothing says they are alike."""
    base = nuisance_start(Stack.of(PhysicalModel(())), batch)
    search = Search(base, batch, batch, batch)
    own = maximise(base.put([OFFSET], [0.012]), (OFFSET, *NUISANCES), batch, 60)
    crossed = Crossed(own, own, np.zeros(batch.n_visits))
    contest = Contest.of(search, Explained(["zero_offset"], crossed, crossed, Final((own,))), np.random.default_rng(2))
    contest = contest if replicas else replace(contest, replica=None)
    far = base.put(list(ELSEWHERE), list(ELSEWHERE.values())).put([CLOCK], [0.012])
    return contest.against(search, Rival("clock_scale", "zero_offset", 0.0, np.nan, far), [])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_twin_is_found_from_wherever_its_climb_begins(seed):
    found = met(survey(0.01, seed))
    assert found.alike
    assert abs(found.observed) < TIE
    assert found.expected < 1.0


def test_what_conditions_tell_apart_is_no_twin():
    found = met(survey(0.7))
    assert not found.alike
    assert found.expected > SAME


@pytest.mark.parametrize(
    ("beside", "alone", "survives"), [(-20.0, -1.0, True), (-1.0, -20.0, True), (-20.0, -20.0, False)]
)
def test_unseen_cells_exclude_a_rival_only_if_none_of_its_summits_does_well_on_them(
    beside, alone, survives, monkeypatch
):
    batch = survey(0.01)

    def cross(search, stack, chosen, near=None):
        return Crossed(None, None, np.full(batch.n_visits, (alone if near is None else beside) / batch.n_visits))

    monkeypatch.setattr(Search, "cross", cross)
    assert met(batch, replicas=False).survives == survives
