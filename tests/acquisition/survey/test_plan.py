"""Survey plans: the plan of the thesis, orders, and sweeps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import SettingError
from acquisition.bench import Rig, Setup, Unit
from acquisition.survey.apply_settings import apply_settings, neighbour
from acquisition.survey.plan import PLANS, Condition, SurveyPlan

SMALL = SurveyPlan(angles_deg=(0.0, 5.0), distances_mm=(300.0, 700.0), reflectances=(0.9,), pings=6, seed=2)


def test_thesis_plan_is_the_thesis():
    plan = PLANS["thesis"]
    assert len(plan) * plan.pings == 133_100
    assert len(plan.angles_deg) == 11
    assert len(plan.distances_mm) == 121
    assert plan.distances_mm[:4] == (30.0, 50.0, 100.0, 150.0)
    assert plan.distances_mm[-1] == 6000.0
    assert {condition.reflectance for condition in plan.conditions} == {0.1, 0.9}
    assert plan.facing
    aside = next(k for k, condition in enumerate(plan.conditions) if condition.angle_deg == 45.0)
    assert plan.ping(aside).incidence[0] == 0.0
    assert SMALL.ping(0).incidence[0] == SMALL.ping(0).angle[0]


def test_incidence_is_independent_of_bearing_in_the_turned_plan():
    plan = PLANS["turned"]
    assert len(plan) == 6912
    assert len(plan) * plan.pings == 55_296
    angle, incidence = np.array([(condition.angle_deg, condition.incidence_deg) for condition in plan.conditions]).T
    assert abs(np.corrcoef(angle, incidence)[0, 1]) < 1e-9
    ping = plan.ping(7)
    np.testing.assert_allclose(np.degrees(ping.incidence), plan.condition(7).incidence_deg)


@pytest.mark.parametrize("name", PLANS)
@pytest.mark.parametrize("order", ["random", "walk", "grid"])
def test_every_order_has_every_condition_once(name, order):
    plan = PLANS[name]
    if order == "walk" and name in ("thesis", "turned"):
        plan = replace(plan, distances_mm=plan.distances_mm[::8])
    conditions = replace(plan, order=order).conditions
    assert len(conditions) == len(plan)
    assert set(conditions) == set(replace(plan, order="grid").conditions)
    assert conditions == replace(plan, order=order).conditions


def test_order_is_fixed_by_its_seed():
    assert replace(SMALL, seed=1).conditions != replace(SMALL, seed=4).conditions
    assert [c.distance_mm for c in replace(SMALL, order="grid").conditions] == [
        300.0,
        700.0,
        300.0,
        700.0,
    ]


def test_walk_order_alternates_distance_and_rarely_changes_other_quantities():
    plan = replace(PLANS["thesis"], order="walk")
    assert plan.moves == len(plan)
    values = np.array([(c.reflectance, c.angle_deg, c.distance_mm) for c in plan.conditions])
    assert (np.diff(values[:, 0]) != 0).sum() == 1  # the reflector is swapped once
    assert (np.diff(values[:, 1]) != 0).sum() == 21  # eleven lines twice, one change of angle or reflector between
    travel = np.abs(np.diff(values[:, 2])).sum()
    assert travel == pytest.approx(22 * 5970.0)  # no travel without a measurement
    order = np.arange(len(plan))
    assert abs(np.corrcoef(order, values[:, 2])[0, 1]) < 0.02  # so that a steady drift is uncorrelated with distance


def test_registers_need_no_move():
    plan = PLANS["gain-sweep"]
    assert (len(plan), plan.moves) == (128, 4)
    assert replace(plan, order="random").moves > 60


def test_times_are_continuous_through_the_plan():
    time = np.concatenate([SMALL.ping(k).time for k in range(len(SMALL))])
    steps = np.diff(time)
    assert set(np.round(steps, 9)) == {2.4, 20.0}
    assert SMALL.seconds == pytest.approx(time[-1] + 20.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pings": 0}, "pings: expected a whole number from 1 to 1000000, got 0"),
        ({"distances_mm": (-1.0,)}, "distances_mm: expected a number from 0 to 100000 mm, got -1 mm"),
        ({"angles_deg": (float("nan"),)}, "angles_deg: expected a finite number, got nan"),
        ({"angles_deg": (5.0, 5.0)}, "angles_deg: 5 is given twice"),
        ({"sweep": {"gain": (3.5,)}}, "sweep.gain: expected a whole number from 0 to 31, got 3.5"),
        ({"sweep": {"gain": ()}}, "sweep.gain: expected at least one value"),
        ({"sweep": {"voltage": (5.0,)}}, "sweep.voltage: no such quantity, expected one of height_mm"),
        ({"order": "zigzag"}, "order: expected one of random, walk, grid, got 'zigzag'"),
    ],
)
def test_invalid_values_are_errors(change, message):
    with pytest.raises(SettingError, match=message):
        replace(SMALL, **change)


def test_crosstalk_plan_measures_each_arrangement_with_the_second_sonar_off():
    swept = [dict(condition.swept) for condition in PLANS["crosstalk"].conditions]
    places = {(s["neighbour_gap_mm"], s["neighbour_turn_deg"]) for s in swept}
    assert places == {(0.0, 0.0), (0.0, 90.0), (50.0, 0.0), (50.0, 90.0)}
    assert {(s["neighbour_gap_mm"], s["neighbour_turn_deg"]) for s in swept if s["neighbour_period_s"] == 0} == places
    other = [s["neighbour_period_s"] for s in swept if s["neighbour_period_s"]]
    assert max(other) < PLANS["crosstalk"].interval_s  # it fires more often than the first


def test_a_condition_without_sweeps_leaves_the_rig_unchanged():
    rig = Rig(Unit.draw(3))
    assert apply_settings(rig, SMALL.condition(0)) == rig


def test_sweeps_change_the_named_settings():
    swept = (("height_mm", 700.0), ("pitch_deg", 10.0), ("gain", 3.0), ("range_register", 24.0), ("loose_share", 0.5))
    rig = apply_settings(Rig(Unit.draw(3), Setup()), Condition(1000.0, 0.0, 0.9, 0.0, swept))
    assert rig.setup.room.height == pytest.approx(0.7)
    assert np.degrees(rig.unit.pitch - Unit.draw(3).pitch) == pytest.approx(10.0)
    assert (rig.setup.gain, rig.setup.range_register) == (3, 24)
    bus = rig.setup.bus
    assert bus.nack + bus.all_ones + bus.lost_write + bus.dropped + bus.bit_flip == pytest.approx(0.5)


@given(st.floats(100, 6000), st.floats(0, 500), st.sampled_from([0.0, 45.0, 90.0]), st.floats(0.05, 5))
def test_a_neighbour_is_received_by_way_of_the_reflector(distance, gap, turn, period):
    values = {
        **Condition(distance, 0.0, 0.9, 0.0).values,
        "neighbour_gap_mm": gap,
        "neighbour_turn_deg": turn,
        "neighbour_period_s": period,
    }
    other = neighbour(values, 6.55e-3)
    assert 2 * distance * 1e-3 <= other.path_m <= (2 * distance + gap + 48.0) * 1e-3
    assert other.strength_db == pytest.approx(0.0, abs=1e-9)  # a mirror on the axis reflects everything
    assert neighbour({**values, "neighbour_period_s": 0.0}, 6.55e-3) is None


def test_pitch_hides_a_reflector_and_loose_wires_disturb_their_share():
    far = Condition(3000.0, 0.0, 0.9, 0.0)
    pings = SurveyPlan((0.0,), (3000.0,), (0.9,), pings=200, interval_s=1.0).ping(0)

    def reading(*swept):
        rig = apply_settings(Rig(Unit.nominal()), replace(far, swept=swept))
        return rig.ping(pings, np.random.default_rng(0)).reading(rig.setup)

    assert reading().echo.mean() > 0.95
    near = np.abs(reading(("pitch_deg", 40.0)).range - 3.0) < 0.3
    assert near.mean() < 0.05
    disturbed = ~reading(("loose_share", 0.5)).answered
    assert disturbed.mean() == pytest.approx(0.3, abs=0.12)  # 0.6 of the disturbed pings are unanswered
