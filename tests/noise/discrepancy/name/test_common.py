"""What both files have alike is no difference between them."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Ping, Recording
from noise.discrepancy.locate.trend import UNCOMPENSATED
from noise.discrepancy.name.common import in_simulation, scatters_alike, with_compensation, with_nuisances
from noise.fitting.batch import Batch
from noise.fitting.stack import JITTER, NUISANCES
from noise.model import simulate
from tests.noise.discrepancy.made import batch_of, law_of, model_of


def in_air(low_c, high_c, seed=0):
    """Return readings of a sensor that allows for the logged temperature of its air."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.5, 3.0, 60), 6)
    ping = Ping.of(distance=distance, time=np.arange(360.0), temperature_c=np.repeat(rng.uniform(low_c, high_c, 60), 6))
    return Batch.of(Recording.of(ping, simulate(model_of(), ping, rng)))


@pytest.mark.parametrize(("low_c", "high_c", "tells"), [(19.9, 20.1, False), (0.0, 40.0, True)])
def test_the_recording_tells_the_compensation_unless_the_simulation_does(low_c, high_c, tells):
    recorded = law_of().at({UNCOMPENSATED: 0.9})
    found = with_compensation(law_of(), [UNCOMPENSATED], [recorded, recorded], in_air(low_c, high_c))
    if tells:
        assert found is None
    else:
        assert found is not None
        assert found.get(UNCOMPENSATED) == pytest.approx(0.9)


def test_nuisance_parameters_that_are_alike_are_left_as_they_are():
    batch = batch_of()
    common = replace(law_of(), familiar={key: law_of().get(key) for key in NUISANCES})
    assert with_nuisances(common, [], [common], [batch], batch) is common


def test_both_files_have_the_likelier_mode_of_the_nuisance_parameters():
    """A law that takes readings that agree for repeated ones gives way to one that takes them for precise."""
    simulated, recorded = batch_of(seed=1), batch_of(seed=2)
    wrong = {("travel_time_jitter", "sigma_m"): 0.02, ("visits", "urn_weight"): 2.0}
    common = law_of().at(wrong)
    common = replace(common, familiar={key: common.get(key) for key in NUISANCES})
    found = with_nuisances(common, [], [replace(law_of(), familiar=common.familiar)], [recorded], simulated)
    assert found.get(("travel_time_jitter", "sigma_m")) == pytest.approx(0.002, abs=0.0005)
    assert found.get(("visits", "urn_weight")) < 0.1


def test_modes_are_compared_with_what_differs_at_its_value():
    """A recording that is 30 mm long does not keep the wrong mode because the law without the offset fits no better."""
    offset = ("zero_offset", "offset_m")
    simulated, recorded = batch_of(seed=1), batch_of({"zero_offset": {"offset_m": 0.03}}, seed=2)
    wrong = {("travel_time_jitter", "sigma_m"): 0.02, ("visits", "urn_weight"): 2.0}
    common = law_of().at(wrong)
    common = replace(common, familiar={key: common.get(key) for key in NUISANCES})
    right = replace(law_of().at({offset: 0.03}), familiar=common.familiar)
    found = with_nuisances(common, [offset], [right], [recorded], simulated)
    assert found.get(("travel_time_jitter", "sigma_m")) == pytest.approx(0.002, abs=0.0005)
    assert found.get(offset) == common.get(offset)


@pytest.mark.parametrize(("factor", "alike"), [(0.5, False), (0.9, True), (1.0, True), (1.1, True), (2.0, False)])
def test_sensors_of_one_type_scatter_alike_within_a_fifth(factor, alike):
    wide = law_of().at({(JITTER, "sigma_m"): 0.01})
    recorded = wide.at({(JITTER, "sigma_m"): 0.01 * factor})
    assert scatters_alike([recorded], wide, [batch_of(visits=20)]) is alike


def test_a_reflector_that_has_moved_is_where_the_simulation_has_it():
    parts = [("fixed_clutter", name) for name in ("presence", "range_m", "spread_m")]
    law, moved = (law_of().put(parts, [0.3, range_m, 0.01]) for range_m in (0.9, 1.2))
    own, gain = in_simulation(law, parts, [moved, moved], batch_of({"fixed_clutter": law.values["fixed_clutter"]}))
    assert own.get(("fixed_clutter", "range_m")) == pytest.approx(0.9, abs=0.02)
    assert gain > -0.01
