"""Sessions: what is on disk after a cell, after a power cut, and after taking up again."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import DeviceError, EchoStatus, NoAnswerError, Ping, Recording, RecordingError, SettingError
from acquisition.bench import Bus, Rig, Setup, Unit
from acquisition.drivers import Echoes, Srf08
from acquisition.io.recording import unfinished
from acquisition.survey.plan import Plan
from acquisition.survey.session import Answer, Nobody, Session
from acquisition.survey.sources import DriverSource, RigSource, Thermometer, told
from acquisition.twins.devantech import BadWire, Srf08Twin

SMALL = Plan(angles_deg=(0.0, 5.0), distances_mm=(300.0, 700.0), reflectances=(0.9,), pings=6, seed=2)
RIG = Rig(Unit.draw(4), Setup(gain=20, output="us", bus=Bus(nack=0.1)))


class PowerCut(Exception):
    pass


class Failing:
    """A source whose power is cut before a given cell."""

    simulated = True

    def check(self):
        return True

    def __init__(self, source, at):
        self.source, self.at = source, at

    def measure(self, plan, number):
        if number == self.at:
            raise PowerCut
        return self.source.measure(plan, number)


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
    with pytest.raises(RecordingError, match=r"line 2: holds another condition than the plan has there"):
        Session(replace(SMALL, distances_mm=(400.0,)), RigSource(RIG), path, resume=True).run()
    with pytest.raises(RecordingError, match=r"line 8: holds another condition"):
        Session(replace(SMALL, pings=12), RigSource(RIG), path, resume=True).run()
    with pytest.raises(RecordingError, match="holds 4 echoes a ping, this session 2"):
        Session(SMALL, RigSource(RIG), path, resume=True, echoes=2).run()
    with pytest.raises(RecordingError, match="column pitch_deg is missing"):
        Session(replace(SMALL, sweep={"pitch_deg": (0.0,)}), RigSource(RIG), path, resume=True).run()
    assert path.read_bytes() == before


def test_an_unfinished_session_goes_on_with_its_own_settings_only(tmp_path):
    path, source = tmp_path / "r.csv", RigSource(RIG)
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(source, 2), path, settings={"gain": 20}).run()
    assert unfinished(path).exists()
    before = path.read_bytes()
    with pytest.raises(RecordingError, match=r"was begun with gain 20, not 14; resume with the settings"):
        Session(SMALL, source, path, resume=True, settings={"gain": 14}).run()
    with pytest.raises(RecordingError, match=r"was begun with seed 2, not 8"):
        Session(replace(SMALL, seed=8), source, path, resume=True, settings={"gain": 20}).run()
    assert path.read_bytes() == before
    Session(SMALL, source, path, resume=True, settings={"gain": 20}).run()
    assert not unfinished(path).exists()


@pytest.mark.parametrize("content", ["", "{", "[1]", "\xff"])
def test_what_a_session_was_begun_with_must_be_readable(tmp_path, content):
    path = tmp_path / "r.csv"
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(RigSource(RIG), 2), path).run()
    unfinished(path).write_text(content, encoding="latin-1")
    with pytest.raises(RecordingError, match=r"r.csv.unfinished: cannot be read: .* then delete it and go on with"):
        Session(SMALL, RigSource(RIG), path, resume=True).run()
    unfinished(path).unlink()
    assert len(Recording.load(Session(SMALL, RigSource(RIG), path, resume=True).run())) == 24


def test_a_torn_last_line_of_an_unfinished_session_is_not_read(tmp_path):
    path = tmp_path / "r.csv"
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(RigSource(RIG), 2), path).run()
    whole = path.read_bytes()
    row = whole.splitlines(keepends=True)[-1]
    for cut in range(1, len(row)):  # at every place, the one before the line's end included
        path.write_bytes(whole + row[:cut])
        assert len(Recording.load(path)) == 12


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

    def place(cell):
        told(sonar)(cell)
        twin.place(Ping.of(cell.distance_mm * 1e-3, np.deg2rad(cell.angle_deg), reflectance=cell.reflectance))

    columns = {"gain": lambda: float(sonar.gain)}
    return DriverSource(sonar, place, columns, sleep=twin.clock.sleep, clock=twin.clock, **settings)


def test_driver_over_its_twin_fills_the_same_table(tmp_path):
    path = Session(SMALL, twin_source(), tmp_path / "r.csv").run()
    recording = Recording.load(path)
    error = np.abs(recording.reading.range - recording.ping.distance)
    straight = recording.ping.angle == 0
    assert (recording.reading.status[straight] == EchoStatus.ECHO).all()
    assert error[straight].max() < 0.03
    assert np.diff(recording.ping.time[:6]) == pytest.approx(2.4)
    assert recording.table["gain"].eq(20).all()


def test_a_swept_register_is_written_to_the_sonar_and_logged(tmp_path):
    plan = replace(SMALL, angles_deg=(0.0,), sweep={"gain": (0.0, 31.0)})
    recording = Recording.load(Session(plan, twin_source(), tmp_path / "r.csv").run())
    assert sorted(set(recording.table["gain"])) == [0, 31]
    loud = recording.table["gain"] == 31
    middle = recording.table.groupby(["distance_mm", loud])["reading_mm"].median().unstack()
    assert (middle[True] <= middle[False]).all()  # a louder echo passes the threshold sooner


def test_a_sonar_without_the_register_refuses_the_plan(tmp_path):
    class Plain:
        def ping(self):
            return Echoes((1.0,))

        def __str__(self):
            return "HC-SR04"

    plan = replace(SMALL, sweep={"gain": (3.0,)})
    source = DriverSource(Plain(), told(Plain()), sleep=lambda s: None)
    with pytest.raises(SettingError, match=r"HC-SR04 has no gain code: take `sweep.gain` out of the plan"):
        Session(plan, source, tmp_path / "r.csv").run()


class Heard:
    """A sonar that gives prepared answers: ranges, or None for no answer."""

    def __init__(self, *answers):
        self.answers = list(answers)

    def ping(self):
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if answer is None:
            raise NoAnswerError("sonar: no acknowledge")
        return Echoes(answer)


class Scripted(Nobody):
    """An operator who gives prepared answers and keeps what was asked."""

    def __init__(self, ready=(), unanswered=(), silent=()):
        self.answers = {"ready": list(ready), "unanswered": list(unanswered), "silent": list(silent)}
        self.asked = []

    def _next(self, kind, default, *asked):
        self.asked.append((kind, *asked))
        return self.answers[kind].pop(0) if self.answers[kind] else default

    def ready(self, before, cell, can_repeat):
        return self._next("ready", Answer.GO, before, cell)

    def unanswered(self, error):
        return self._next("unanswered", Answer.QUIT, str(error))

    def silent(self, cells):
        return self._next("silent", Answer.SKIP, cells)

    def kinds(self):
        return [item[0] for item in self.asked]


def session(path, sonar, operator, **settings):
    return Session(SMALL, DriverSource(sonar, sleep=lambda s: None), path, operator=operator, **settings)


def test_operator_is_asked_for_every_cell_in_order(tmp_path):
    operator = Scripted()
    session(tmp_path / "r.csv", Heard((1.0,)), operator).run()
    assert [item[2] for item in operator.asked] == list(SMALL.cells)
    assert [item[1] for item in operator.asked] == [None, *SMALL.cells[:-1]]


def test_what_is_skipped_is_measured_when_resumed(tmp_path):
    path = tmp_path / "r.csv"
    session(path, Heard((1.0,)), Scripted(ready=[Answer.GO, Answer.SKIP, Answer.GO, Answer.QUIT])).run()
    assert len(Recording.load(path)) == 12
    operator = Scripted()
    session(path, Heard((2.0,)), operator, resume=True).run()
    assert [item[2] for item in operator.asked] == [SMALL.cells[1], SMALL.cells[3]]
    assert Recording.load(path).table["reading_mm"].tolist() == [1000.0] * 12 + [2000.0] * 12


def test_repeat_replaces_the_cell_before(tmp_path):
    operator = Scripted(ready=[Answer.GO, Answer.REPEAT])
    sonar = Heard(*[(1.0,)] * (5 + 6), (2.0,))
    session(tmp_path / "r.csv", sonar, operator).run()
    recording = Recording.load(tmp_path / "r.csv")
    assert recording.table["reading_mm"].tolist() == [2000.0] * 24
    assert [item[2] for item in operator.asked[:3]] == [SMALL.cells[0], SMALL.cells[1], SMALL.cells[0]]
    assert operator.asked[2][1] is None  # to be arranged anew


def test_a_dead_wire_is_refused_before_anything_is_written(tmp_path):
    for dead in (BadWire(stuck=True), BadWire(nack=1.0)):  # 0xFF for ever, and nobody there
        path = tmp_path / f"{dead.stuck}.csv"
        with pytest.raises(NoAnswerError, match=r"5 pings, no answer: this is no silence"):
            Session(SMALL, twin_source(dead), path).run()
        assert path.read_bytes() == b""


def test_a_wire_that_dies_later_leaves_whole_cells_and_no_zeros(tmp_path):
    path = tmp_path / "r.csv"
    sonar = Heard(*[(1.0,)] * (5 + 6 + 3), None)
    with pytest.raises(NoAnswerError, match=r"5 pings, no answer: this is no silence"):
        Session(SMALL, DriverSource(sonar, sleep=lambda s: None), path).run()
    recording = Recording.load(path)
    assert recording.reading.status.tolist() == [EchoStatus.ECHO] * 9 + [EchoStatus.NO_ANSWER] * 3
    sonar = Heard(*[(1.0,)] * (5 + 10), None)
    with pytest.raises(NoAnswerError, match=r"10 pings in a row, no answer: this is no silence"):
        Session(replace(SMALL, pings=24), DriverSource(sonar, sleep=lambda s: None), tmp_path / "s.csv").run()
    assert (tmp_path / "s.csv").read_bytes() == b""


def test_a_wire_that_comes_back_after_a_lost_cell_leaves_it_empty(tmp_path):
    sonar = Heard(*[(1.0,)] * (5 + 6), *[None] * 6, (1.0,))
    session(tmp_path / "r.csv", sonar, Nobody()).run()
    status = Recording.load(tmp_path / "r.csv").reading.status
    assert status.tolist() == [EchoStatus.ECHO] * 6 + [EchoStatus.NO_ANSWER] * 6 + [EchoStatus.ECHO] * 12


def test_a_mended_wire_goes_on_with_the_same_cell(tmp_path):
    operator = Scripted(unanswered=[Answer.GO, Answer.GO])
    sonar = Heard(*[None] * 5, *[(1.0,)] * 5, *[None] * 10, (1.0,))
    Session(
        replace(SMALL, pings=12), DriverSource(sonar, sleep=lambda s: None), tmp_path / "r.csv", operator=operator
    ).run()
    assert operator.kinds()[:3] == ["unanswered", "ready", "unanswered"]
    assert (Recording.load(tmp_path / "r.csv").reading.status == EchoStatus.ECHO).all()


def test_single_lost_pings_are_written_down_as_no_answer(tmp_path):
    sonar = Heard(*[(1.0,)] * 5, *[(1.0,), None, ()] * 8, (1.0,))
    session(tmp_path / "r.csv", sonar, Nobody()).run()
    text = (tmp_path / "r.csv").read_text().splitlines()
    table = Recording.load(tmp_path / "r.csv").table
    assert table["reading_mm"].fillna(-1).tolist() == [1000.0, -1, 0.0] * 8
    assert text[2].count(",,") > 0  # no answer is an empty field, not 0
    assert ",," not in text[3]


def test_a_deaf_sonar_is_asked_about_before_and_during(tmp_path):
    many = replace(SMALL, distances_mm=tuple(float(d) for d in range(100, 700, 100)))
    operator = Scripted(silent=[Answer.GO, Answer.SKIP])
    source = DriverSource(Heard(()), sleep=lambda s: None)
    Session(many, source, tmp_path / "r.csv", operator=operator).run()
    asked = [item for item in operator.asked if item[0] == "silent"]
    assert asked == [("silent", 0), ("silent", 0), ("silent", 5), ("silent", 5)]  # tested again, believed, later twice


def test_hardware_taken_up_again_is_another_session(tmp_path):
    path, source = tmp_path / "r.csv", twin_source()
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(source, 2), path).run()
    Session(SMALL, source, path, resume=True).run()
    assert sorted(set(Recording.load(path).table["session"])) == ["0", "1"]


def test_recording_needs_none_of_the_heavy_packages():
    code = (
        "import sys, acquisition, acquisition.bench, acquisition.survey.session, acquisition.survey.sources, acquisition.drivers, "
        "acquisition.twins.devantech; "
        "print([m for m in ('torch', 'gymnasium', 'scipy', 'matplotlib', 'noise', 'rich', 'tyro') if m in sys.modules])"
    )
    root = Path(__file__).parents[3]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout.strip() == "[]"


def test_the_thermometer_is_read_when_its_value_is_old(tmp_path):
    file, now = tmp_path / "temperature", [0.0]
    file.write_text("21437\n")
    thermometer = Thermometer(file, clock=lambda: now[0])
    file.write_text("22000\n")
    assert thermometer() == 21.437
    now[0] = 11.0
    assert thermometer() == 22.0


@pytest.mark.parametrize(("content", "message"), [("", "expected thousandths"), ("85000", "85 degC, expected -60 to")])
def test_a_thermometer_that_tells_nothing_is_refused(tmp_path, content, message):
    file = tmp_path / "temperature"
    file.write_text(content)
    with pytest.raises(DeviceError, match=message):
        Thermometer(file)
