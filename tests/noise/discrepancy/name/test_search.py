"""Selected effects are those that differ, and nothing that both files have alike."""

import numpy as np
import pytest
import torch

from noise.discrepancy.name.alternatives import place_of
from noise.discrepancy.name.candidates import (
    explains_nothing,
    gained_at_bounds,
    log_prior,
    resolved_periods,
    sampled_bounds,
    shows,
    starts_of,
    with_sampled_bounds,
)
from noise.discrepancy.name.exchange import exchanged
from noise.discrepancy.name.folds import Folds, with_simulated_offset
from noise.discrepancy.name.hypothesis import Hypothesis, standard_error, weights
from noise.effects import CATALOGUE
from noise.fitting.fit import Fit
from noise.fitting.stack import JITTER, VISITS
from noise.fitting.starts import guesses_of
from tests.noise.discrepancy.made import CHANGES, batch_of, found_of, law_of, search_of

torch.set_num_threads(1)


def test_folds_share_no_condition_and_omit_nothing():
    batch = batch_of()
    folds = Folds.of(batch, np.random.default_rng(1))
    parts = [set(np.round(part.ping.distance, 6)) for part in (folds.first, folds.second, folds.unseen)]
    assert not any(parts[j] & parts[k] for j, k in ((0, 1), (0, 2), (1, 2)))
    assert len(folds.first) + len(folds.second) + len(folds.unseen) == len(batch)
    assert len(folds.both) == len(folds.first) + len(folds.second)


def test_the_same_law_differs_in_nothing():
    _, found = search_of({}).run()
    assert found.effects == ()


@pytest.mark.parametrize("name", ["sound_speed", "dropped_reading"])
def test_a_changed_effect_is_selected_alone(name):
    found = found_of(name)[1]
    assert found.effects in ((name,), ("clock_scale",) if name == "sound_speed" else ())


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(CHANGES) - {"sound_speed", "dropped_reading"}))
def test_each_changed_effect_is_selected_alone(name):
    _, found = search_of(CHANGES[name]).run()
    assert found.effects == (name,)


def test_a_sonar_that_stands_far_from_the_robots_origin_has_an_offset():
    _, found = search_of({"zero_offset": {"offset_m": 0.2}}).run()
    assert found.effects == ("zero_offset",)


def test_what_both_files_have_is_no_difference():
    change = CHANGES["noise_burst"]
    search = search_of(change, simulated=batch_of(change, seed=77))
    _, found = search.run()
    assert found.effects == ()
    assert search.shared  # it joined the common law, whatever it is called there


def test_speed_of_sound_and_clock_are_told_to_be_alike():
    search, found = found_of("sound_speed")
    place = place_of(search, found, found.effects[0])
    assert {"sound_speed", "clock_scale"} <= set(place.listed)
    assert min(place.likely["sound_speed"], place.likely["clock_scale"]) > 0.2
    assert sum(place.likely.values()) == pytest.approx(1.0)


def test_of_two_effects_that_fit_alike_the_selected_one_has_no_advantage():
    """Nuisance parameters that were fitted without an effect fit each effect worse than those fitted with it."""
    search = search_of(CHANGES["sensitivity"], seed=4)
    _, found = search.run()
    likely = place_of(search, found, found.effects[0]).likely
    assert min(likely["sensitivity"], likely["specular_loss"]) > 0.1


def test_a_difference_counts_as_much_as_it_repeats_from_visit_to_visit():
    def hypothesis(nats):
        return Hypothesis((), (law_of(), law_of()), np.asarray(nats))

    def first(one, other):
        rng = np.random.default_rng(0)
        return weights({"one": hypothesis(one), "other": hypothesis(other)}, rng)["one"]

    flat = np.zeros(50)
    assert first(flat, flat) == pytest.approx(0.5)
    assert first(flat + 0.4, flat) > 0.999  # 20 nats, of every visit
    lucky = np.where(np.arange(50) == 0, 20.0, 0.0)
    assert 0.6 < first(lucky, flat) < 0.99  # 20 nats, of one visit
    assert first(lucky, flat) + first(flat, lucky) == pytest.approx(1.0)


def test_two_causes_are_found_where_a_third_imitates_both():
    law = law_of()
    shifted_and_gated = {"zero_offset": {"offset_m": 0.015}, "range_gate": {"listen_m": 2.2}}
    search = search_of(shifted_and_gated, law=law)
    none = search.null()
    search.tried[()], search.base[()] = {}, (search.common, none)
    for name, values in shifted_and_gated.items():
        start = none.stacks[0].put([(name, p) for p in values], values.values())
        search.tried[()][name] = search.crossed(start, none, (name,), own_scatter=False)
    wrong = search.crossed(none.stacks[0].put([("sensitivity", "loss_db")], [45.0]), none, ("sensitivity",), False)
    greedy = search.crossed(
        wrong.stacks[0].put([("sound_speed", "temperature_c")], [15.0]), wrong, ("sensitivity", "sound_speed"), False
    )
    found = exchanged(search, greedy)
    assert set(found.effects) == set(shifted_and_gated)
    assert found.value > greedy.value


def test_what_stands_in_a_place_is_what_was_tried_given_the_effects_before_it():
    search = search_of({})
    none, law = search.null(), search.null().stacks

    def hypothesis(*effects):
        return Hypothesis(effects, law, none.nats)

    first, second = "zero_offset", "dropped_reading"
    search.tried[()] = {name: hypothesis(name) for name in (first, second, "clock_scale")}
    search.tried[(first,)] = {name: hypothesis(first, name) for name in (second, "time_walk")}
    search.base |= {(): (search.common, none), (first,): (search.common, hypothesis(first))}
    assert set(place_of(search, hypothesis(first, second), second).likely) == {second, "time_walk"}


def test_scatter_is_named_beside_a_greater_effect_that_does_not_act_on_the_echo():
    """Lost readings move no echo, so that nothing of them can pass for scatter."""
    change = {"dropped_reading": {"probability": 0.3}, "travel_time_jitter": {"sigma_m": 0.006}}
    _, found = search_of(change).run()
    assert set(found.effects) == {"dropped_reading", JITTER}


def test_no_period_is_sought_that_sampling_cannot_resolve():
    batch = batch_of(visits=40, pings=1, wait_s=600.0)
    low, high = resolved_periods(batch)
    assert low == pytest.approx(1200.0)
    assert high <= 0.5 * np.ptp(batch.ping.time)
    period = sampled_bounds(batch)[("thermal_drift", "period_s")]
    assert low <= period.low < period.high <= high
    assert all(period.low < start < period.high for start in period.starts)


def test_what_has_not_lost_half_of_itself_by_the_end_is_no_warming_up():
    batch = batch_of(visits=40, pings=1, wait_s=6.0)
    tau = sampled_bounds(batch)[("warm_up", "tau_s")]
    left = CATALOGUE["warm_up"](offset_m=0.02, tau_s=tau.high)
    end = np.exp(-np.ptp(batch.ping.time) / tau.high)
    assert left.values["offset_m"] * end == pytest.approx(0.01)
    assert not shows(CATALOGUE["warm_up"], batch_of(visits=3, pings=1, wait_s=0.5))


def test_effects_of_time_need_times():
    batch = batch_of()
    object.__setattr__(batch, "timed", False)
    assert not shows(CATALOGUE["thermal_drift"], batch)
    assert shows(CATALOGUE["zero_offset"], batch)


def test_a_fixed_echo_far_away_is_no_ring_down_with_its_least_decay():
    change = {"fixed_clutter": {"presence": 0.1, "range_m": 0.7, "spread_m": 0.001}}
    batch = batch_of(change)
    base = with_sampled_bounds(law_of(), batch)
    values = {("ring_down", "probability"): 0.08, ("ring_down", "range_m"): 0.7}
    decay = next(p for p in CATALOGUE["ring_down"].parameters if p.name == "decay_m")
    assert gained_at_bounds(base.at({**values, ("ring_down", "decay_m"): decay.low}), base, "ring_down", batch) > 10.0
    assert gained_at_bounds(base.at({**values, ("ring_down", "decay_m"): 0.05}), base, "ring_down", batch) == 0.0
    alike = {"ring_down", "fixed_clutter"}
    assert search_of(change, without=tuple(sorted(CATALOGUE.keys() - alike))).run()[1].effects == ("fixed_clutter",)


def test_what_is_gained_only_at_a_bound_counts_for_nothing():
    search = search_of({"fixed_clutter": {"presence": 0.1, "range_m": 0.7, "spread_m": 0.001}})
    values = {("ring_down", "probability"): 0.08, ("ring_down", "range_m"): 0.7}
    decay = search.common.parameter(("ring_down", "decay_m"))
    short, longer = (
        search.null().stacks[0].at({**values, ("ring_down", "decay_m"): each}) for each in (decay.low, 2.0 * decay.low)
    )
    beyond = gained_at_bounds(short, search.common, "ring_down", search.joined)
    assert beyond > 0.0
    sizes = [stack.log_size_prior(search.common, ["ring_down"]) for stack in (short, longer)]
    priors = [log_prior(stack, search.common, ["ring_down"], search.joined) for stack in (short, longer)]
    assert priors[0] - priors[1] == pytest.approx(sizes[0] - sizes[1] - beyond)


def test_a_cycle_of_a_day_is_no_bound():
    day = {"thermal_drift": {"sine_k": 5.0, "period_s": 86_400.0}}
    batch = batch_of(day, visits=900, pings=1, wait_s=600.0)
    law = with_sampled_bounds(law_of(), batch)
    found = law.at({("thermal_drift", name): value for name, value in day["thermal_drift"].items()})
    assert gained_at_bounds(found, law, "thermal_drift", batch) == 0.0
    assert not explains_nothing(found, law, "thermal_drift", batch)


@pytest.mark.parametrize("trips", [0.0, 1.0, 2.0])
def test_round_trips_to_the_target_alone_are_no_bound(trips):
    change = {"previous_ping": {"presence": 0.5, "far_m": 12.0 if trips == 0.0 else 0.0, "trips": trips, "wait_m": 0.3}}
    batch = batch_of(change)
    law = law_of().at({("previous_ping", name): value for name, value in change["previous_ping"].items()})
    assert gained_at_bounds(law, law_of(), "previous_ping", batch) == 0.0


def test_the_level_of_what_is_heard_anyway_may_end_at_its_bound():
    behind = {"presence": 0.9, "behind_m": 0.4, "loss_db": 0.0, "follow": 0.0}
    batch = batch_of({"background_reflector": behind})
    loss = next(p for p in CATALOGUE["background_reflector"].parameters if p.name == "loss_db")
    stack = law_of().at({("background_reflector", name): value for name, value in behind.items()})
    loudest = stack.at({("background_reflector", "loss_db"): loss.low})
    assert gained_at_bounds(loudest, law_of(), "background_reflector", batch) == 0.0


def test_errors_of_sums_over_long_and_short_visits_are_those_of_repeated_surveys():
    rng = np.random.default_rng(0)
    pings = np.r_[np.full(3, 200.0), np.full(100, 5.0)]
    sums = rng.normal(0.6 * pings, 0.5 * np.sqrt(pings), (4000, len(pings)))
    stated = np.median([standard_error(each, pings) for each in sums])
    assert stated == pytest.approx(np.std(sums.sum(axis=1)), rel=0.3)
    assert np.median([standard_error(each) for each in sums]) > 5.0 * stated


def test_few_conditions_are_one_part_and_each_parameter_costs_what_it_gains_by_chance():
    few, many = search_of({}, visits=11), search_of({}, visits=40)
    assert (len(few.parts), len(many.parts)) == (1, 2)
    assert len(few.parts[0]) == len(few.joined)
    stack = few.null().stacks[0]
    costs = [few.scored(effects, [stack]).prior for effects in ((), ("zero_offset",))]
    assert costs[0] == 0.0
    assert np.isclose(costs[1], -0.5 * np.log(few.joined.n_visits))


def test_an_error_that_the_simulation_has_at_the_same_position_is_expected():
    recorded, simulated = batch_of(seed=3), batch_of({"zero_offset": {"offset_m": 0.02}}, seed=3)
    known = with_simulated_offset(recorded, law_of(), simulated).simulated_offset
    assert np.nanmedian(known) == pytest.approx(0.02, abs=0.003)
    elsewhere = with_simulated_offset(recorded, law_of(), batch_of(seed=4)).simulated_offset
    assert np.isnan(elsewhere).all()


def test_a_reading_that_sticks_at_a_target_that_never_moves_is_the_target():
    still = batch_of(visits=1, pings=50)
    at = float(still.ping.distance[0])
    stuck, cluttered = (
        law_of().at({("stuck", "probability"): 0.4, ("stuck", "value_m"): at + 0.01}),
        law_of().at({("fixed_clutter", "presence"): 0.4, ("fixed_clutter", "range_m"): at - 0.02}),
    )
    for stack, name in ((stuck, "stuck"), (cluttered, "fixed_clutter")):
        assert explains_nothing(stack, law_of(), name, still)
        assert not explains_nothing(stack, law_of(), name, batch_of(visits=20, pings=3))


def test_an_effect_that_explains_nothing_keeps_no_other_from_being_tried(monkeypatch):
    alike = {"noise_burst", "corrupted_byte", "spike"}
    search = search_of(CHANGES["noise_burst"], without=tuple(sorted(CATALOGUE.keys() - alike)))
    monkeypatch.setattr(search, "explains", lambda found, name: name != "noise_burst")
    assert search.run()[1].effects


def test_an_effect_that_gains_nothing_with_its_own_nuisances_is_not_selected(monkeypatch):
    search = search_of({})
    none = search.null()
    seeming = Hypothesis(("time_walk",), none.stacks, none.nats + 1.0)
    monkeypatch.setattr(search, "explains", lambda found, name: True)
    monkeypatch.setattr(search, "polished", lambda found: Hypothesis(found.effects, found.stacks, none.nats - 1.0))
    assert search.winner(none, {"time_walk": seeming}) is None
    monkeypatch.setattr(search, "polished", lambda found: found)
    assert search.winner(none, {"time_walk": seeming}) == "time_walk"


def test_what_an_effect_estimates_from_readings_is_fitted_however_unlikely_it_seems():
    """Slow noise describes an oscillation as well, until the oscillation is fitted."""
    batch = batch_of({"thermal_drift": {"sine_k": 5.0, "period_s": 900.0}})
    slow = law_of().put([(VISITS, "ping_correlation"), (VISITS, "placement_m")], [0.9, 0.02])
    _, starts = starts_of(slow, [], "thermal_drift", batch.thin(400), batch, np.random.default_rng(1))
    periods = [start.get(("thermal_drift", "period_s")) for start in starts]
    for guess in guesses_of(CATALOGUE["thermal_drift"], batch):
        assert guess["period_s"] in periods
    assert any(abs(period / 900.0 - 1.0) < 0.1 for period in periods)


def test_what_was_fitted_under_the_law_before_is_not_lost():
    search = search_of(CHANGES["fixed_clutter"])
    none, key = search.null(), ("fixed_clutter", "range_m")
    known = none.stacks[0].at({("fixed_clutter", "presence"): 0.3, key: 0.9, ("fixed_clutter", "spread_m"): 0.01})
    good = search.crossed(known, none, ("fixed_clutter",), own_scatter=False)
    elsewhere = Fit(known.at({key: 7.0}), (), 0.0)  # from where no small step leads back
    assert search.met(elsewhere, none, "fixed_clutter").value < good.value - search.least_gain
    search.tried[none.effects] = {"fixed_clutter": good}
    assert search.met(elsewhere, none, "fixed_clutter").value > good.value - 1.0
