"""What is asked for next is measured in the trial's own world."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from acquisition import Ping, Recording
from acquisition.bench.acoustics.receiver import GAINS
from training.proof.trials.follow import changed, measure
from training.proof.trials.mix import make
from training.proof.trials.world import with_setup


def test_what_is_asked_for_is_recorded_with_a_new_visit_for_every_ping(tmp_path):
    made = make("confounded", np.random.default_rng(3))
    there = [{"distance_mm": d, "angle_deg": 10.0, "incidence_deg": 0.0} for d in (500.0, 900.0)]
    files = measure(made, [{"pings": 7, "conditions": there, "also": {}}], tmp_path, np.random.default_rng(0))
    measured, anywhere = (Recording.load(files[name]) for name in ("measured-0", "anywhere-0"))
    assert len(measured) == len(anywhere) == 7
    assert measured.ping.distance.tolist() == pytest.approx([0.5, 0.9] * 3 + [0.5])
    assert np.rad2deg(measured.ping.angle).tolist() == pytest.approx([10.0] * 7)
    assert len(np.unique(measured.ping.run)) == 7
    assert np.ptp(measured.reading.range[measured.ping.distance == 0.5]) > 0.0  # each put down anew


def test_a_pause_that_matters_takes_two_pings_of_which_the_later_counts(tmp_path):
    made = make("confounded", np.random.default_rng(3))
    asked = {"pings": 4, "conditions": [{"distance_mm": 800.0, "angle_deg": 0.0, "incidence_deg": 0.0}]}
    files = measure(made, [{**asked, "also": {"interval_s": 0.005}}], tmp_path, np.random.default_rng(0))
    time = Recording.load(files["measured-0"]).ping.time
    assert len(time) == 4
    assert np.diff(time) == pytest.approx(np.full(3, 20.105))


def test_a_sensor_that_is_to_be_warm_is_measured_later_and_the_other_at_once(tmp_path):
    made = make("confounded", np.random.default_rng(3))
    asked = {"pings": 4, "conditions": [{"distance_mm": 800.0, "angle_deg": 0.0, "incidence_deg": 0.0}]}
    files = measure(made, [{**asked, "also": {"start_s": 7200.0}}], tmp_path, np.random.default_rng(0))
    measured, anywhere = (Recording.load(files[name]).ping.time for name in ("measured-0", "anywhere-0"))
    assert measured == pytest.approx(anywhere + 7200.0)


def test_settings_are_changed_as_asked():
    world = with_setup(make("confounded", np.random.default_rng(1)).real, gain=20)
    before = world.rig.setup
    louder = changed(world, {"gain_db": 6.0}).rig.setup.gain
    assert 20.0 * np.log10(GAINS[louder] / GAINS[before.gain]) == pytest.approx(6.0, abs=1.5)
    assert changed(world, {"range_m": 11.0}).rig.setup.range_register == 255
    assert changed(world, {}) is world


def test_fresh_readings_speak_for_the_law_that_drew_them(tmp_path):
    pytest.importorskip("torch")
    from noise.discrepancy.judge.next_measurement import next_measurement
    from noise.discrepancy.judge.proposal import law
    from noise.discrepancy.name.rivals import Rival
    from noise.fitting.stack import Stack
    from training.proof.told import told

    usual = {"sensitivity": {"loss_db": 40.0}, "travel_time_jitter": {"sigma_m": 0.004}}
    own = Stack({**usual, "visits": {"placement_m": 0.003}, "zero_offset": {"offset_m": 0.012}})
    other = Stack({**usual, "visits": {"placement_m": 0.003}, "clock_scale": {"error": 0.012}})
    rival = Rival("clock_scale", "zero_offset", 1.0, 0.0, other)
    seen = Ping.of(distance=np.linspace(0.7, 1.3, 20))
    asked = next_measurement(own, [("zero_offset", "clock_scale", other)], seed=0, seen=seen)
    assert asked[0].proposal.ping.distance.max() <= 2.6
    found = SimpleNamespace(
        verdict=SimpleNamespace(next_measurement=asked), explanation=own, rivals=(rival,), to_verdict=dict
    )
    for drawn, sign in ((own, 1), (other, -1)):
        for name in ("measured", "anywhere"):
            ping = asked[0].proposal.ping
            reading = law(drawn, ping).sample(np.random.default_rng(0))
            Recording.of(ping, reading).save(tmp_path / f"{name}-0.csv")
        (told_of,) = told(found, tmp_path)
        assert sign * told_of["here"] > 0
        assert told_of["pings"] == len(ping)
