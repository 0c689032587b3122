"""Sessions: what is on disk after a cell, after a power cut, and after taking up again."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import EchoStatus, NoAnswerError, Ping, Recording, RecordingError, SettingError
from acquisition.bench import Bus, Rig, Setup, Unit
from acquisition.drivers import Echoes, Srf08
from acquisition.drivers.twins import BadWire, Srf08Twin
from acquisition.plan import PLANS, Cell, Plan
from acquisition.session import Session
from acquisition.sources import DriverSource, RigSource

SMALL = Plan(angles_deg=(0.0, 5.0), distances_mm=(300.0, 700.0), reflectances=(0.9,), pings=6, seed=2)
RIG = Rig(Unit.draw(4), Setup(gain=20, output="us", bus=Bus(nack=0.1)))


class PowerCut(Exception):
    pass


class Failing:
    """A source whose power is cut before a given cell."""

    simulated = True

    def __init__(self, source, at):
        self.source, self.at = source, at

    def measure(self, plan, number):
        if number == self.at:
            raise PowerCut
        return self.source.measure(plan, number)


def test_thesis_plan_is_the_thesis():
    plan = PLANS["thesis"]
    assert len(plan) * plan.pings == 133_100
    assert len(plan.angles_deg) == 11
    assert len(plan.distances_mm) == 121
    assert plan.distances_mm[:4] == (30.0, 50.0, 100.0, 150.0)
    assert plan.distances_mm[-1] == 6000.0
    assert {cell.reflectance for cell in plan.cells} == {0.1, 0.9}
    assert plan.facing
    aside = next(k for k, cell in enumerate(plan.cells) if cell.angle_deg == 45.0)
    assert plan.ping(aside).incidence[0] == 0.0
    assert SMALL.ping(0).incidence[0] == SMALL.ping(0).angle[0]


def test_plans_order_is_a_permutation_fixed_by_its_seed():
    random, again, other, grid = (replace(SMALL, seed=seed) for seed in (1, 1, 3, None))
    assert random.cells == again.cells
    assert set(random.cells) == set(grid.cells) == set(other.cells)
    assert [cell.distance_mm for cell in grid.cells] == [300.0, 700.0, 300.0, 700.0]


def test_times_go_on_through_the_plan():
    time = np.concatenate([SMALL.ping(k).time for k in range(len(SMALL))])
    steps = np.diff(time)
    assert set(np.round(steps, 9)) == {2.4, 20.0}


def test_session_writes_what_the_rig_heard(tmp_path):
    path = Session(SMALL, RigSource(RIG, seed=1), tmp_path / "r.csv", echoes=3).run()
    recording = Recording.load(path)
    assert len(recording) == 24
    assert [c for c in recording.table if c.startswith("echo")] == ["echo_2_mm", "echo_3_mm"]
    assert {"temperature_c", "humidity_pct", "gain", "range_mm"} <= set(recording.covariates)
    assert recording.run.max() == 0
    lost = recording.reading.status == EchoStatus.NO_ANSWER
    assert lost.any()
    assert recording.table.loc[lost, "echo_2_mm"].isna().all()


@pytest.mark.parametrize("at", [0, 1, 3])
def test_interrupted_and_resumed_is_byte_for_byte_the_unbroken_recording(tmp_path, at):
    source = RigSource(RIG, seed=5)
    whole = Session(SMALL, source, tmp_path / "whole.csv").run()
    path = tmp_path / "broken.csv"
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(source, at), path).run()
    Session(SMALL, source, path, resume=True).run()
    assert path.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("cut", [1, 17, 250, 700])
def test_torn_tail_is_cut_off(tmp_path, cut):
    source = RigSource(RIG, seed=5)
    path = Session(SMALL, source, tmp_path / "r.csv").run()
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    Session(SMALL, source, path, resume=True).run()
    assert path.read_bytes() == whole


@pytest.mark.parametrize("left", [b"", b"time_s,sess"])
def test_torn_header_starts_over(tmp_path, left):
    source, path = RigSource(RIG, seed=5), tmp_path / "r.csv"
    path.write_bytes(left)
    Session(SMALL, source, path, resume=True).run()
    assert len(Recording.load(path)) == 24


def test_nothing_is_overwritten_unasked(tmp_path):
    source, path = RigSource(RIG), tmp_path / "r.csv"
    Session(SMALL, source, path).run()
    before = path.read_bytes()
    with pytest.raises(RecordingError, match=r"is there already; go on with it \(--resume\) or give another file"):
        Session(SMALL, source, path).run()
    assert path.read_bytes() == before


def test_another_plan_is_not_mixed_in(tmp_path):
    path = Session(SMALL, RigSource(RIG), tmp_path / "r.csv").run()
    before = path.read_bytes()
    with pytest.raises(RecordingError, match=r"line 8: holds another condition than the plan has there"):
        Session(replace(SMALL, seed=8), RigSource(RIG), path, resume=True).run()
    with pytest.raises(RecordingError, match="line 2: holds another condition"):
        Session(replace(SMALL, distances_mm=(400.0,)), RigSource(RIG), path, resume=True).run()
    with pytest.raises(RecordingError, match="holds 4 echoes a ping, this session 2"):
        Session(SMALL, RigSource(RIG), path, resume=True, echoes=2).run()
    assert path.read_bytes() == before


def test_a_plan_that_ends_sooner_is_another_plan(tmp_path):
    path = Session(replace(SMALL, seed=None), RigSource(RIG), tmp_path / "r.csv").run()
    with pytest.raises(RecordingError, match="line 14: holds another condition"):
        Session(replace(SMALL, seed=None, angles_deg=(0.0,)), RigSource(RIG), path, resume=True).run()


def test_each_cell_is_on_disk_when_it_is_told(tmp_path):
    path, rows = tmp_path / "r.csv", []
    Session(SMALL, RigSource(RIG), path).run(lambda done, total: rows.append((done, total, len(Recording.load(path)))))
    assert rows == [(6, 24, 6), (12, 24, 12), (18, 24, 18), (24, 24, 24)]


def test_echoes_are_bounded(tmp_path):
    with pytest.raises(SettingError, match="echoes must lie from 1 to 17, got 18"):
        Session(SMALL, RigSource(RIG), tmp_path / "r.csv", echoes=18)


def twin_source(wire=None, **settings):
    still = Setup(gain=20, placement_m=0.0, tilt_deg=0.0)
    twin = Srf08Twin(Rig(Unit.nominal(), still), np.random.default_rng(0), wire=wire or BadWire())
    sonar = Srf08(twin, gain=20, range_register=140, sleep=twin.clock.sleep, clock=twin.clock)

    def arrange(cell):
        twin.place(Ping.of(cell.distance_mm * 1e-3, np.deg2rad(cell.angle_deg), reflectance=cell.reflectance))

    return DriverSource(sonar, arrange, {"gain": 20.0}, sleep=twin.clock.sleep, clock=twin.clock, **settings)


def test_driver_over_its_twin_fills_the_same_table(tmp_path):
    path = Session(SMALL, twin_source(), tmp_path / "r.csv").run()
    recording = Recording.load(path)
    error = np.abs(recording.reading.range - recording.ping.distance)
    straight = recording.ping.angle == 0
    assert (recording.reading.status[straight] == EchoStatus.ECHO).all()
    assert error[straight].max() < 0.03
    assert np.diff(recording.ping.time[:6]) == pytest.approx(2.4)
    assert recording.table["gain"].eq(20).all()


def test_operator_is_asked_for_every_cell_in_order(tmp_path):
    class Deaf:
        def ping(self):
            return Echoes(())

    asked: list[Cell] = []
    source = DriverSource(Deaf(), asked.append, sleep=lambda s: None)
    recording = Recording.load(Session(SMALL, source, tmp_path / "r.csv").run())
    assert asked == list(SMALL.cells)
    assert (recording.reading.status == EchoStatus.NO_ECHO).all()


def test_dead_wire_is_written_down_as_no_answer_until_patience_ends(tmp_path):
    path = tmp_path / "r.csv"
    Session(replace(SMALL, pings=3), twin_source(BadWire(stuck=True)), path).run()
    assert (Recording.load(path).reading.status == EchoStatus.NO_ANSWER).all()
    source = twin_source(BadWire(nack=1.0), patience=4)
    with pytest.raises(NoAnswerError, match=r"4 pings in a row; the cells before are kept"):
        Session(replace(SMALL, pings=3), source, tmp_path / "s.csv").run()
    assert len(Recording.load(tmp_path / "s.csv")) == 3


def test_hardware_taken_up_again_is_another_session(tmp_path):
    path, source = tmp_path / "r.csv", twin_source()
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(source, 2), path).run()
    Session(SMALL, source, path, resume=True).run()
    assert sorted(set(Recording.load(path).table["session"])) == ["0", "1"]


def test_recording_needs_none_of_the_heavy_packages():
    code = (
        "import sys, acquisition, acquisition.bench, acquisition.session, acquisition.sources, acquisition.drivers, "
        "acquisition.drivers.twins; "
        "print([m for m in ('torch', 'gymnasium', 'scipy', 'matplotlib', 'noise', 'rich', 'tyro') if m in sys.modules])"
    )
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout.strip() == "[]"


def test_the_turned_plan_turns_reflectors_apart_from_their_bearing():
    plan = PLANS["turned"]
    assert len(plan) == 6912
    assert len(plan) * plan.pings == 55_296
    angle, incidence = np.array([(cell.angle_deg, cell.incidence_deg) for cell in plan.cells]).T
    assert abs(np.corrcoef(angle, incidence)[0, 1]) < 1e-9
    ping = plan.ping(7)
    np.testing.assert_allclose(np.degrees(ping.incidence), plan.cell(7).incidence_deg)
