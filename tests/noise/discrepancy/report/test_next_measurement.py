"""The next measurement: known answers, a gain over random conditions, and determinism."""

from functools import cache

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.name.alternatives import Place
from noise.discrepancy.name.hypothesis import Hypothesis
from noise.discrepancy.report.design import Candidates, candidates_of, law_of, weigh
from noise.discrepancy.report.next_measurement import merged, next_measurements
from noise.discrepancy.result import Measurement
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

BASE = {
    "sensitivity": {"loss_db": 40.0},
    "travel_time_jitter": {"sigma_m": 0.004},
    "visits": {"placement_m": 0.003, "urn_weight": 0.02, "urn_width_m": 0.004},
}
SPECULAR = {"specular_loss": {"strength": 0.6}}
PAIRS = {
    "offset and scale": ({"zero_offset": {"offset_m": 0.012}}, {"clock_scale": {"error": 0.012}}),
    "beam and face": ({"beam_width": {"ka": 4.0}}, SPECULAR),
    "gain and gate": ({"sensitivity": {"loss_db": 48.0}}, {"range_gate": {"listen_m": 2.0}}),
    "offset and warm-up": ({"zero_offset": {"offset_m": 0.012}}, {"warm_up": {"offset_m": 0.014, "tau_s": 1500.0}}),
    "air and clock": ({"sound_speed": {"temperature_c": 40.0}}, {"clock_scale": {"error": -0.028}}),
}


def recorded():
    """Return a recording at 0.6 to 1.8 m and -20 to 20 deg, the sensor turned with the target."""
    distance, angle = np.meshgrid(np.linspace(0.6, 1.8, 5), np.deg2rad([-20, -10, 0, 10, 20]), indexing="ij")
    distance, angle = np.repeat(distance.ravel(), 4), np.repeat(angle.ravel(), 4)
    ping = Ping.of(distance, angle, time=0.5 * np.arange(len(distance)))
    return Batch.of(Recording.of(ping, Reading.of(np.round(distance, 3))))


def place_of(pair, p_other=0.4):
    """Return a place of two effects that fit nearly as well."""
    own, other = pair
    (first,), (second,) = own, other
    fits = {name: fitted(name, values) for name, values in ((first, own), (second, other))}
    return Place(first, {first: 1.0 - p_other, second: p_other}, 0.5, fits)


def fitted(name, values):
    return Hypothesis((name,), (Stack({**BASE, **values}),), np.zeros(1))


def asked(*pairs):
    """Return the measurements for pairs of explanations."""
    return next_measurements([place_of(pair) for pair in pairs], recorded(), np.random.default_rng(0))


@cache
def asked_once(name):
    """Return the measurements for a known pair."""
    return asked(PAIRS[name])


def test_an_offset_is_told_from_a_scale_at_two_distances_as_far_apart_as_allowed():
    (found,) = asked_once("offset and scale")
    allowed = candidates_of(recorded()).distance
    assert set(found.conditions["distance"]) == {allowed.min(), allowed.max()}
    assert not np.any(found.conditions["angle"])
    assert found.do.startswith("place the target at 0.4 m and 2.7 m; ")


def test_a_target_that_touches_the_sensor_is_no_distance_to_measure_at():
    batch = Batch.of(Recording.of(Ping.of([0.0, 1.0]), Reading.of([0.01, 1.0])))
    assert batch.resolution <= candidates_of(batch).distance.min() < 1.0 < candidates_of(batch).distance.max()


def test_columns_may_have_the_names_of_conditions():
    plain = Recording.of(Ping.of([0.5, 1.0]), Reading.of([0.5, 1.0]))
    named = Recording(plain.table.assign(distance=7.0, time=8.0, run=9.0))
    own, other = (candidates_of(Batch.of(recording)) for recording in (plain, named))
    assert np.array_equal(own.distance, other.distance)
    assert {name: set(values) for name, values in other.covariates.items() if name not in own.covariates} == {
        "distance": {7.0}, "time": {8.0}, "run": {9.0},
    }  # fmt: skip


def test_air_is_told_from_a_clock_by_a_thermometer():
    (found,) = asked_once("air and clock")
    assert "thermometer beside the sensor" in found.do
    assert found.conditions == {}


def test_a_beam_is_told_from_a_smooth_target_by_turning_one_of_them_alone():
    (found,) = asked_once("beam and face")
    angle, incidence = (np.array(found.conditions[name]) for name in ("angle", "incidence"))
    assert np.any((angle == 0.0) != (incidence == 0.0))
    assert "alone turned by" in found.do
    assert "°" in found.do


def test_warm_up_is_told_from_an_offset_by_waiting():
    (found,) = asked_once("offset and warm-up")
    assert "with the sensor on for two hours" in found.do
    assert found.also["time"]["change"] == 7200.0


def test_equal_laws_are_not_worth_a_measurement():
    same = {"zero_offset": {"offset_m": 0.012}}
    place = Place(
        "zero_offset",
        {"zero_offset": 0.5, "dropped_reading": 0.5},
        0.0,
        dict.fromkeys(("zero_offset", "dropped_reading"), fitted("zero_offset", same)),
    )
    (found,) = next_measurements([place], recorded(), np.random.default_rng(0))
    assert found.pings == 0
    assert "inspect the sensor" in found.do


def test_an_improbable_alternative_asks_for_nothing():
    assert next_measurements([place_of(PAIRS["offset and scale"], 0.001)], recorded(), np.random.default_rng(0)) == ()


def test_the_same_measurement_is_asked_for_once():
    once = merged([Measurement("turn", ("a", "b"), 20), Measurement("turn", ("a", "c"), 30)])
    assert once == (Measurement("turn", ("a", "b", "c"), 30),)


def test_one_measurement_serves_several_pairs():
    offset = {"zero_offset": {"offset_m": 0.012}}
    (found,) = asked(PAIRS["offset and scale"], (offset, {"clock_scale": {"error": 0.015}}))
    assert found.separates == ("zero_offset", "clock_scale")


def test_equal_seeds_give_equal_measurements():
    assert asked(PAIRS["beam and face"]) == asked_once("beam and face")


def test_the_linear_program_balances_two_rivals():
    # the third condition tells neither rival; the first two tell one each
    assert list(weigh(np.array([[2.0, 0.0, 0.1], [0.0, 2.0, 0.1]]))) == [0, 1]


def laws_of(found, pair):
    """Return both laws of proposed conditions, 2000 readings of each, without a changed setting."""
    columns = {name: np.repeat(value, 2000) for name, value in found.items()}
    ping = Ping.of(**columns, time=0.0)
    return [law_of(Stack({**BASE, **values}), ping) for values in pair]


def divergence(laws):
    """Return half of Jeffreys' divergence per reading, nats, with the probability of arbitrary readings."""
    total = 0.0
    for k, law in enumerate(laws):
        reading = law.sample(np.random.default_rng(k))
        floor = 3e-4 * np.where(reading.echo, 1e-4, 1.0)
        own, other = (np.log(np.exp(each.log_prob(reading)) + floor) for each in (law, laws[1 - k]))
        total += 0.5 * float(np.mean(own - other))
    return total


@pytest.mark.parametrize("name", ["offset and scale", "beam and face"])
def test_a_proposal_tells_three_times_what_a_random_recorded_condition_does(name):
    (found,) = asked_once(name)
    seen = recorded().ping[::4]
    columns = {each: getattr(seen, each) for each in ("distance", "angle", "incidence", "reflectance")}
    assert divergence(laws_of(found.conditions, PAIRS[name])) >= 3.0 * divergence(laws_of(columns, PAIRS[name]))


def test_the_number_of_pings_settles_the_pair():
    pair = PAIRS["offset and scale"]
    (found,) = asked_once("offset and scale")
    n, k = 300, found.pings // len(found.conditions["distance"])
    ping = Ping.of(np.tile(np.repeat(found.conditions["distance"], k), n), time=0.0)
    laws = [law_of(Stack({**BASE, **values}), ping) for values in pair]
    for truth, rival in (laws, laws[::-1]):
        reading = truth.sample(np.random.default_rng(5))
        ratio = np.maximum(truth.log_prob(reading), -20.0) - np.maximum(rival.log_prob(reading), -20.0)
        assert np.mean(ratio.reshape(n, -1).sum(axis=1) > 0) >= 0.99


def test_candidates_stay_near_the_recording():
    ping = Candidates(candidates_of(recorded())).ping
    assert ping.distance.min() >= 0.39
    assert ping.distance.max() <= 2.71
    assert np.abs(ping.angle).max() <= np.deg2rad(30.01)
