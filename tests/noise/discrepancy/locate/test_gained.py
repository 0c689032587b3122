"""What an explanation gains, by the respect in which readings are better explained, and where."""

import numpy as np
import pytest
import torch

from acquisition import Ping, Recording
from noise.discrepancy.locate.gained import by_aspect, gained, with_gained
from noise.discrepancy.locate.locate import Finding
from noise.discrepancy.locate.residuals import residuals
from noise.discrepancy.name.explanation import Final, intervals
from noise.effects import CATALOGUE
from noise.effects.medium import ASSUMED_TEMPERATURE_C
from noise.fitting.batch import Batch
from noise.fitting.fit import log_likelihood, maximise
from noise.fitting.stack import NUISANCES, Stack
from noise.physical import PhysicalModel

torch.set_num_threads(1)
SONAR = {"travel_time_jitter": {"sigma_m": 0.004}, "sensitivity": {"loss_db": 33.0}}
LAW = Stack({**SONAR, "visits": {"placement_m": 0.003}})
KEY = ("zero_offset", "offset_m")


def heard(seed, effects, cells=60, pings=8, beyond=0.0, measured=True):
    """Return readings of a sonar with effects, those that stand in nearer cells than `beyond` m without them.

    A thermometer is in the log where air was `measured`.
    """
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.3, 3.0, cells), pings)
    moved = Ping.of(distance=distance + np.repeat(rng.normal(0, 0.003, cells), pings))
    plain, whole = (
        PhysicalModel([CATALOGUE[name](**values) for name, values in {**SONAR, **more}.items()]).law(moved).sample(rng)
        for more in ({}, effects)
    )
    range_ = np.where(distance > beyond, whole.range, plain.range)
    table = Recording.of(Ping.of(distance=distance), whole).table.assign(reading_mm=1e3 * range_)
    if measured:
        table = table.assign(temperature_c=20.0)
    return Batch.of(Recording(table))


def told(batch, effects, p=1e-6):
    rng = np.random.default_rng(0)
    after = Stack({**LAW.values, **effects})
    return gained(LAW, after, batch, residuals(LAW, batch, rng), p, rng)


CASES = [
    ({"spike": {"probability": 0.02}}, "extra_mode"),
    ({"zero_offset": {"offset_m": 0.02}}, "bias"),
    ({"clock_scale": {"error": 0.02}}, "scale"),
    ({"dropped_reading": {"probability": 0.1}}, "detection"),
    ({"travel_time_jitter": {"sigma_m": 0.012}}, "spread"),
]


@pytest.mark.parametrize(("effects", "aspect"), CASES, ids=[aspect for _, aspect in CASES])
def test_each_cause_is_told_in_the_respect_in_which_it_shows(effects, aspect):
    found = told(heard(1, effects), effects)
    assert (found.aspect, found.p_value) == (aspect, 1e-6)
    assert found.region == {} or aspect == "scale"  # which far readings show more than near ones
    assert found.nats > 10


def test_a_handful_of_strays_is_told_with_the_share_that_they_are():
    effects = {"spike": {"probability": 0.02}}
    batch = heard(2, effects)
    strays = batch.is_outlier(batch.reading.range - batch.ping.distance).mean()
    assert told(batch, effects).size == pytest.approx(strays, abs=0.003)


@pytest.mark.parametrize(("effects", "_"), CASES)
def test_what_is_gained_by_every_respect_is_all_that_is_gained(effects, _):
    batch, after = heard(3, effects), Stack({**LAW.values, **effects})
    parts, gain = by_aspect(LAW, after, batch), log_likelihood(after, batch) - log_likelihood(LAW, batch)
    np.testing.assert_allclose(sum(parts.values()), gain, atol=1e-9)


def test_it_is_told_where_and_only_where_it_is_gained():
    effects = {"dropped_reading": {"probability": 0.3}}
    distance = told(heard(4, effects, beyond=2.0), effects).region["distance_mm"]
    assert distance[0] > 1700
    assert distance[1] > 2700


def test_an_explanation_that_gains_nothing_tells_nothing():
    assert told(heard(5, {}), {"dropped_reading": {"probability": 0.3}}) is None


def finding(aspect, p, nats=20.0, size=2.0):
    return Finding(aspect, {}, size, "1", p, nats)


def test_what_a_scan_surely_located_is_not_told_again():
    sure, strays = finding("scale", 0.002), finding("extra_mode", 1e-9, 50.0)
    assert with_gained([sure], finding("bias", 1e-9)) == (sure,)
    assert with_gained([sure], None) == (sure,)
    assert with_gained([sure], strays) == (strays, sure)
    # faint, and of a family of which the explanation says otherwise
    assert with_gained([finding("scale", 0.04)], finding("spread", 1e-9)) == (finding("spread", 1e-9),)
    # what the air of another day carries comes last, whatever it weighs
    assert with_gained([finding("time_correlation", 0.002, 90.0)], strays)[0] == strays


def final_of(batch):
    return Final((maximise(LAW.put([KEY], [0.0]), (KEY, *NUISANCES), batch, 80),))


def test_what_a_law_finds_in_the_readings_it_stands_for_counts_as_nothing():
    recorded = heard(6, {"zero_offset": {"offset_m": 0.020}})
    simulated = heard(7, {"zero_offset": {"offset_m": 0.008}})
    final = final_of(recorded)
    alone, against = (intervals(final, recorded, LAW, own)[KEY] for own in (None, simulated))
    assert alone.low < 0.020 < alone.high
    assert against.low < 0.012 < against.high
    # both are known by as many readings
    assert (against.high - against.low) / (alone.high - alone.low) == pytest.approx(np.sqrt(2.0), rel=0.25)


@pytest.mark.slow
def test_intervals_of_an_offset_cover_as_often_as_they_say():
    covered = []
    for seed in range(20):
        recorded = heard(100 + seed, {"zero_offset": {"offset_m": 0.01}}, 30, 4)
        interval = intervals(final_of(recorded), recorded, LAW, heard(200 + seed, {}, 30, 4))[KEY]
        covered.append(interval.low < 0.01 < interval.high)
    assert sum(covered) >= 15


@pytest.mark.parametrize(
    ("key", "a_kelvin"), [(("clock_scale", "error"), 1.71e-3), (("sound_speed", "temperature_c"), 1.0)]
)
def test_air_that_nobody_measured_adds_what_half_a_kelvin_of_it_would_have_made(key, a_kelvin):
    measured, unknown = (heard(8, {}, measured=told) for told in (True, False))
    final = Final((maximise(LAW, (key, *NUISANCES), unknown, 80),))
    sd = [(i.high - i.low) / 2.0 / 1.6449 for i in (intervals(final, b, LAW, None)[key] for b in (measured, unknown))]
    assert np.sqrt(sd[1] ** 2 - sd[0] ** 2) == pytest.approx(0.5 * a_kelvin, rel=0.15)


@pytest.mark.slow
def test_intervals_cover_on_days_on_which_the_air_was_another():
    covered = []
    for seed in range(20):
        air = {"sound_speed": {"temperature_c": ASSUMED_TEMPERATURE_C + np.random.default_rng(seed).normal(0.0, 0.5)}}
        recorded = heard(300 + seed, {"clock_scale": {"error": 0.01}, **air}, 30, 4, measured=False)
        key = ("clock_scale", "error")
        final = Final((maximise(LAW.put([key], [0.0]), (key, *NUISANCES), recorded, 80),))
        interval = intervals(final, recorded, LAW, None)[key]
        covered.append(interval.low < 0.01 < interval.high)
    assert sum(covered) >= 15
