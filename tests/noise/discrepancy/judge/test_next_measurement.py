"""What to measure next: each thing once, with all that it tells apart."""

import numpy as np
import pytest

from acquisition import Ping
from noise.discrepancy.judge.next_measurement import Measurement, merged, next_measurement
from noise.discrepancy.judge.proposal import DRAWS, LATER, USUAL, floored, law, propose, ratios
from noise.fitting.stack import Stack


def test_the_same_measurement_is_asked_for_once():
    asked = [
        Measurement("log a thermometer", ("drift", "clock"), 1),
        Measurement("go to 6 m", ("drift", "offset"), 30),
        Measurement("log a thermometer", ("drift", "speed"), 4),
    ]
    assert merged(asked) == [
        Measurement("log a thermometer", ("drift", "clock", "speed"), 4),
        Measurement("go to 6 m", ("drift", "offset"), 30),
    ]


BASE = {
    "sensitivity": {"loss_db": 40.0},
    "travel_time_jitter": {"sigma_m": 0.004},
    "visits": {"placement_m": 0.003, "urn_weight": 0.02, "urn_width_m": 0.004},
}
PAIRS = {
    "zero and clock": ({"zero_offset": {"offset_m": 0.012}}, {"clock_scale": {"error": 0.012}}),
    "beam and face": ({"beam_width": {"ka": 4.0}}, {"specular_loss": {"strength": 0.6}}),
    "gain and gate": ({"sensitivity": {"loss_db": 48.0}}, {"range_gate": {"listen_m": 4.0}}),
    "spike and noise": ({"spike": {"probability": 0.02}}, {"false_alarm": {"per_metre": 0.004}}),
}


def stacks(pair):
    return [Stack({**BASE, **values}) for values in PAIRS[pair]]


# spikes and noise differ by nearly as much wherever one looks: there, only the number of pings is to be right
@pytest.mark.parametrize("pair", [pair for pair in PAIRS if pair != "spike and noise"])
def test_what_is_proposed_tells_three_times_what_a_random_measurement_does(pair):
    own, other = stacks(pair)
    anywhere = ratios(own, other, USUAL.pings(), lambda stack: stack, 0, DRAWS).mean()
    assert propose(own, [other], seed=0).nats >= 3.0 * anywhere


@pytest.mark.parametrize("pair", PAIRS)
def test_what_is_proposed_settles_the_pair(pair):
    own, other = stacks(pair)
    found = propose(own, [other], seed=0)
    campaigns, each = 200, found.pings
    rows = np.resize(np.arange(len(found.ping)), campaigns * each)
    for truth, lie in ((own, other), (other, own)):
        laws = [law(found.setting.change(stack), found.ping[rows]) for stack in (truth, lie)]
        reading = laws[0].sample(np.random.default_rng(1))
        ratio = (floored(laws[0], reading) - floored(laws[1], reading)).reshape(campaigns, each).sum(axis=1)
        # asked for is 99 %, where ratios are normal; those of rare events are not quite
        assert np.mean(ratio > 0) >= 0.97


def test_the_beam_is_told_from_the_face_by_turning_one_alone():
    own, other = stacks("beam and face")
    assert "alone" in propose(own, [other], seed=0).setting.words


def test_one_measurement_serves_for_several_rivals():
    own, other = stacks("zero and clock")
    third = Stack({**BASE, "zero_offset": {"offset_m": -0.02}})
    rivals = [("zero_offset", "clock_scale", other), ("zero_offset", "time_walk", third)]
    asked = next_measurement(own, rivals, seed=0)
    assert len(asked) == 1
    assert asked[0].separates == ("zero_offset", "clock_scale", "time_walk")


def test_twins_are_not_worth_a_measurement():
    own, _ = stacks("zero and clock")
    asked = next_measurement(own, [("zero_offset", "warm_up", own)], seed=0)
    assert asked[0].pings == 0
    assert "inspect the sensor" in asked[0].do


def test_what_fades_after_power_on_is_asked_for_when_the_sensor_is_warm():
    own = Stack({**BASE, "zero_offset": {"offset_m": 0.012}})
    warming = Stack({**BASE, "warm_up": {"offset_m": 0.014, "tau_s": 1500.0}})
    found = propose(own, [warming], seed=0)
    assert found.setting == LATER
    assert found.pings <= 20
    (asked,) = next_measurement(own, [("zero_offset", "warm_up", warming)], seed=0)
    assert "has been on for two hours" in asked.do
    assert asked.settings()["also"] == {"start_s": 7200.0}


def test_no_law_is_asked_how_the_air_is_two_hours_on():
    own = Stack({**BASE, "zero_offset": {"offset_m": 0.012}})
    drifting = Stack({**BASE, "thermal_drift": {"sine_k": 6.0, "period_s": 3000.0}})
    assert propose(own, [drifting], seed=0).setting != LATER
    (asked,) = next_measurement(own, [("zero_offset", "thermal_drift", drifting)], seed=0)
    assert "log a thermometer" in asked.do


def test_a_thermometer_tells_warm_air_from_whatever_else():
    own = Stack({**BASE, "zero_offset": {"offset_m": 0.012}})
    warm = Stack({**BASE, "sound_speed": {"temperature_c": 29.0}})
    (asked,) = next_measurement(own, [("zero_offset", "sound_speed", warm)], seed=0)
    assert "29.0 degC" in asked.do
    assert asked.warmer_k == pytest.approx(29.0 - 22.8, abs=0.1)


def test_nothing_is_asked_for_beyond_what_was_varied():
    own, other = stacks("zero and clock")
    seen = Ping.of(
        distance=np.linspace(0.4, 2.4, 40), angle=np.deg2rad(np.linspace(-25, 25, 40)), incidence=np.zeros(40)
    )
    ping = propose(own, [other], seed=0, seen=seen).ping
    assert ping.distance.min() >= 0.4
    assert ping.distance.max() <= 2.4
    assert np.abs(ping.angle).max() <= np.deg2rad(25.01)
    assert np.abs(ping.incidence).max() <= np.deg2rad(10.01)  # never turned so far
    # of one place alone nothing is told: one has to go farther
    alone = propose(own, [other], seed=0, seen=Ping.of(distance=np.full(40, 1.2))).ping
    assert np.ptp(alone.distance) > 0.0 or alone.distance[0] != 1.2


def test_what_the_air_of_another_day_would_blur_is_asked_for_near():
    own = Stack({**BASE, "zero_offset": {"offset_m": 0.012}})
    warming = Stack({**BASE, "warm_up": {"offset_m": 0.014, "tau_s": 1500.0}})
    assert propose(own, [warming], seed=0).ping.distance.max() <= 1.3


def test_nothing_that_was_never_set_is_asked_for_where_placing_tells_as_much():
    own, other = stacks("zero and clock")
    assert propose(own, [other], seed=0).setting.also == ()
    # silence has to be listened to for longer, or louder
    own, other = stacks("gain and gate")
    assert propose(own, [other], seed=0).setting.also != ()


def test_air_blurs_a_law_the_farther_the_more():
    near, far = (
        law(Stack(BASE), Ping.of(distance=np.full(20_000, d))).sample(np.random.default_rng(0)) for d in (0.4, 4.0)
    )
    spread = [np.std(r.range[r.echo & (np.abs(r.range - d) < 0.1)]) for r, d in ((near, 0.4), (far, 4.0))]
    # half a kelvin is 0.084 % of 4 m
    assert np.sqrt(spread[1] ** 2 - spread[0] ** 2) == pytest.approx(0.0034, rel=0.2)
