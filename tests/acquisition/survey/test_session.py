"""Sessions: the recording after a condition, after a power cut, and after resuming."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import DeviceError, EchoStatus, NoAnswerError, Ping, Recording, RecordingError, SettingError
from acquisition.bench import Bus, Rig, Setup, Unit
from acquisition.drivers import Echoes, Srf08, Srf10
from acquisition.io.recording import unfinished_path
from acquisition.survey.plan import SurveyPlan
from acquisition.survey.session import Answer, NoOperator, Session
from acquisition.survey.sources import DriverSource, RigSource, Thermometer, check_sweep, register_writer
from acquisition.twins.devantech import BadWire, Srf08Twin

SMALL = SurveyPlan(angles_deg=(0.0, 5.0), distances_mm=(300.0, 700.0), reflectances=(0.9,), pings=6, seed=2)
RIG = Rig(Unit.draw(4), Setup(gain=20, output="us", bus=Bus(nack=0.1)))


class PowerCut(Exception):
    pass


class Failing:
    """A source whose power fails before a given condition."""

    simulated = True

    def check(self):
        return True

    def __init__(self, source, at):
        self.source, self.at = source, at

    def measure(self, plan, number):
        if number == self.at:
            raise PowerCut
        return self.source.measure(plan, number)


def test_session_records_the_readings_of_the_rig(tmp_path):
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
def test_a_resumed_recording_is_identical_to_an_unbroken_one(tmp_path, at):
    source = RigSource(RIG, seed=5)
    whole = Session(SMALL, source, tmp_path / "whole.csv").run()
    path = tmp_path / "broken.csv"
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(source, at), path).run()
    Session(SMALL, source, path, resume=True).run()
    assert path.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("cut", [1, 17, 250, 700])
def test_an_incomplete_visit_is_cut_off(tmp_path, cut):
    source = RigSource(RIG, seed=5)
    path = Session(SMALL, source, tmp_path / "r.csv").run()
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    Session(SMALL, source, path, resume=True).run()
    assert path.read_bytes() == whole


@pytest.mark.parametrize("left", [b"", b"time_s,sess"])
def test_an_incomplete_header_is_replaced(tmp_path, left):
    source, path = RigSource(RIG, seed=5), tmp_path / "r.csv"
    path.write_bytes(left)
    Session(SMALL, source, path, resume=True).run()
    assert len(Recording.load(path)) == 24


def test_an_existing_file_is_not_overwritten(tmp_path):
    source, path = RigSource(RIG), tmp_path / "r.csv"
    Session(SMALL, source, path).run()
    before = path.read_bytes()
    with pytest.raises(RecordingError, match=r"exists already; continue it with --resume or give another file"):
        Session(SMALL, source, path).run()
    assert path.read_bytes() == before


def test_another_plan_is_an_error(tmp_path):
    path = Session(SMALL, RigSource(RIG), tmp_path / "r.csv").run()
    before = path.read_bytes()
    with pytest.raises(RecordingError, match=r"line 2: the condition is not the one of the plan"):
        Session(replace(SMALL, distances_mm=(400.0,)), RigSource(RIG), path, resume=True).run()
    with pytest.raises(RecordingError, match=r"line 8: the condition is not"):
        Session(replace(SMALL, pings=12), RigSource(RIG), path, resume=True).run()
    with pytest.raises(RecordingError, match="has 4 echoes per ping, this session 2"):
        Session(SMALL, RigSource(RIG), path, resume=True, echoes=2).run()
    with pytest.raises(RecordingError, match="column pitch_deg is missing"):
        Session(replace(SMALL, sweep={"pitch_deg": (0.0,)}), RigSource(RIG), path, resume=True).run()
    assert path.read_bytes() == before


def test_an_unfinished_session_resumes_with_its_own_settings_only(tmp_path):
    path, source = tmp_path / "r.csv", RigSource(RIG)
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(source, 2), path, settings={"gain": 20}).run()
    assert unfinished_path(path).exists()
    before = path.read_bytes()
    with pytest.raises(RecordingError, match=r"was started with gain 20, not 14; resume with the original settings"):
        Session(SMALL, source, path, resume=True, settings={"gain": 14}).run()
    with pytest.raises(RecordingError, match=r"was started with seed 2, not 8"):
        Session(replace(SMALL, seed=8), source, path, resume=True, settings={"gain": 20}).run()
    assert path.read_bytes() == before
    Session(SMALL, source, path, resume=True, settings={"gain": 20}).run()
    assert not unfinished_path(path).exists()


@pytest.mark.parametrize("content", ["", "{", "[1]", "\xff"])
def test_unreadable_settings_of_a_session_are_an_error(tmp_path, content):
    path = tmp_path / "r.csv"
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(RigSource(RIG), 2), path).run()
    unfinished_path(path).write_text(content, encoding="latin-1")
    with pytest.raises(RecordingError, match=r"r.csv.unfinished: cannot be read: .* then delete it and continue with"):
        Session(SMALL, RigSource(RIG), path, resume=True).run()
    unfinished_path(path).unlink()
    assert len(Recording.load(Session(SMALL, RigSource(RIG), path, resume=True).run())) == 24


def test_an_incomplete_last_line_of_an_unfinished_session_is_ignored(tmp_path):
    path = tmp_path / "r.csv"
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(RigSource(RIG), 2), path).run()
    whole = path.read_bytes()
    row = whole.splitlines(keepends=True)[-1]
    for cut in range(1, len(row)):  # at every byte, including the one before the end of the line
        path.write_bytes(whole + row[:cut])
        assert len(Recording.load(path)) == 12


def test_each_condition_is_on_disk_when_it_is_reported(tmp_path):
    path, rows = tmp_path / "r.csv", []
    Session(SMALL, RigSource(RIG), path).run(lambda done, total: rows.append((done, total, len(Recording.load(path)))))
    assert rows == [(6, 24, 6), (12, 24, 12), (18, 24, 18), (24, 24, 24)]


def test_echoes_are_bounded(tmp_path):
    with pytest.raises(SettingError, match="echoes must lie from 1 to 17, got 18"):
        Session(SMALL, RigSource(RIG), tmp_path / "r.csv", echoes=18)


def twin_source(wire=None, **settings):
    setup = Setup(gain=20, placement_m=0.0, tilt_deg=0.0)
    twin = Srf08Twin(Rig(Unit.nominal(), setup), np.random.default_rng(0), wire=wire or BadWire())
    sonar = Srf08(twin, gain=20, range_register=140, sleep=twin.clock.sleep, clock=twin.clock)

    def place(condition):
        register_writer(sonar)(condition)
        twin.place(
            Ping.of(condition.distance_mm * 1e-3, np.deg2rad(condition.angle_deg), reflectance=condition.reflectance)
        )

    columns = {"gain": lambda: float(sonar.gain)}
    return DriverSource(sonar, place, columns, sleep=twin.clock.sleep, clock=twin.clock, **settings)


def test_a_driver_with_its_twin_records_the_same_columns(tmp_path):
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
    assert (middle[True] <= middle[False]).all()  # a stronger echo crosses the threshold earlier


def test_a_session_that_logs_other_columns_does_not_resume(tmp_path):
    path, source = tmp_path / "r.csv", twin_source()
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(source, 1), path).run()
    before, columns = path.read_bytes(), {**source.columns, "temperature_c": 20.0}
    with pytest.raises(RecordingError, match=r"gain, this session logs .*, temperature_c; resume with"):
        Session(SMALL, replace(source, columns=columns), path, resume=True).run()
    assert path.read_bytes() == before
    assert len(Recording.load(Session(SMALL, source, path, resume=True).run())) == 24


def test_a_plan_that_sweeps_a_missing_register_is_an_error(tmp_path):
    class Plain:
        def ping(self):
            return Echoes((1.0,))

        def __str__(self):
            return "HC-SR04"

    plan = replace(SMALL, sweep={"gain": (3.0,)})
    source = DriverSource(Plain(), register_writer(Plain()), sleep=lambda s: None)
    with pytest.raises(SettingError, match=r"HC-SR04 has no gain code: remove `sweep.gain` from the plan"):
        Session(plan, source, tmp_path / "r.csv").run()


def test_a_plan_that_sweeps_beyond_the_registers_of_the_sonar_is_an_error_before_the_first_visit():
    sonar = Srf10(None, gain=5)
    message = r"SRF10 gain must be a whole number from 0 to 16, got 31 \(.*\): change `sweep.gain` in the plan"
    plan = replace(SMALL, sweep={"gain": (3.0, 31.0)})
    with pytest.raises(SettingError, match=message):
        check_sweep(sonar, plan)
    assert sonar.gain == 5
    loud = next(condition for condition in plan.conditions if condition.values["gain"] == 31.0)
    with pytest.raises(SettingError, match=message):
        register_writer(sonar)(loud)
    check_sweep(sonar, replace(SMALL, sweep={"gain": (0.0, 16.0)}))


class Prepared:
    """A sonar with prepared answers: ranges, or None for no answer."""

    def __init__(self, *answers):
        self.answers = list(answers)

    def ping(self):
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if answer is None:
            raise NoAnswerError("sonar: no acknowledge")
        return Echoes(answer)


class Scripted(NoOperator):
    """An operator with prepared answers, who records the questions."""

    def __init__(self, ready=(), unanswered=(), silent=()):
        self.answers = {"ready": list(ready), "unanswered": list(unanswered), "silent": list(silent)}
        self.asked = []

    def _next(self, kind, default, *asked):
        self.asked.append((kind, *asked))
        return self.answers[kind].pop(0) if self.answers[kind] else default

    def ready(self, before, condition, can_repeat):
        return self._next("ready", Answer.GO, before, condition)

    def unanswered(self, error):
        return self._next("unanswered", Answer.QUIT, str(error))

    def silent(self, conditions):
        return self._next("silent", Answer.SKIP, conditions)

    def kinds(self):
        return [item[0] for item in self.asked]


def session(path, sonar, operator, **settings):
    return Session(SMALL, DriverSource(sonar, sleep=lambda s: None), path, operator=operator, **settings)


def test_the_operator_is_asked_for_every_condition_in_order(tmp_path):
    operator = Scripted()
    session(tmp_path / "r.csv", Prepared((1.0,)), operator).run()
    assert [item[2] for item in operator.asked] == list(SMALL.conditions)
    assert [item[1] for item in operator.asked] == [None, *SMALL.conditions[:-1]]


def test_a_skipped_condition_is_measured_when_resumed(tmp_path):
    path = tmp_path / "r.csv"
    session(path, Prepared((1.0,)), Scripted(ready=[Answer.GO, Answer.SKIP, Answer.GO, Answer.QUIT])).run()
    assert len(Recording.load(path)) == 12
    operator = Scripted()
    session(path, Prepared((2.0,)), operator, resume=True).run()
    assert [item[2] for item in operator.asked] == [SMALL.conditions[1], SMALL.conditions[3]]
    assert Recording.load(path).table["reading_mm"].tolist() == [1000.0] * 12 + [2000.0] * 12


def test_repeat_replaces_the_previous_condition(tmp_path):
    operator = Scripted(ready=[Answer.GO, Answer.REPEAT])
    sonar = Prepared(*[(1.0,)] * (5 + 6), (2.0,))
    session(tmp_path / "r.csv", sonar, operator).run()
    recording = Recording.load(tmp_path / "r.csv")
    assert recording.table["reading_mm"].tolist() == [2000.0] * 24
    assert [item[2] for item in operator.asked[:3]] == [SMALL.conditions[0], SMALL.conditions[1], SMALL.conditions[0]]
    assert operator.asked[2][1] is None  # to be set up again


def test_a_failed_connection_is_an_error_before_anything_is_written(tmp_path):
    for dead in (BadWire(stuck=True), BadWire(nack=1.0)):  # always 0xFF, and no device
        path = tmp_path / f"{dead.stuck}.csv"
        with pytest.raises(NoAnswerError, match=r"no answer to 5 pings: the connection failed"):
            Session(SMALL, twin_source(dead), path).run()
        assert path.read_bytes() == b""


def test_a_later_failure_of_the_connection_leaves_complete_visits_without_zeros(tmp_path):
    path = tmp_path / "r.csv"
    sonar = Prepared(*[(1.0,)] * (5 + 6 + 3), None)
    with pytest.raises(NoAnswerError, match=r"no answer to 5 pings: the connection failed"):
        Session(SMALL, DriverSource(sonar, sleep=lambda s: None), path).run()
    recording = Recording.load(path)
    assert recording.reading.status.tolist() == [EchoStatus.ECHO] * 9 + [EchoStatus.NO_ANSWER] * 3
    sonar = Prepared(*[(1.0,)] * (5 + 10), None)
    with pytest.raises(NoAnswerError, match=r"no answer to 10 pings in a row: the connection failed"):
        Session(replace(SMALL, pings=24), DriverSource(sonar, sleep=lambda s: None), tmp_path / "s.csv").run()
    assert (tmp_path / "s.csv").read_bytes() == b""


def test_a_condition_without_any_answer_is_recorded_if_the_sonar_answers_again(tmp_path):
    sonar = Prepared(*[(1.0,)] * (5 + 6), *[None] * 6, (1.0,))
    session(tmp_path / "r.csv", sonar, NoOperator()).run()
    status = Recording.load(tmp_path / "r.csv").reading.status
    assert status.tolist() == [EchoStatus.ECHO] * 6 + [EchoStatus.NO_ANSWER] * 6 + [EchoStatus.ECHO] * 12


def test_a_repaired_connection_continues_with_the_same_condition(tmp_path):
    operator = Scripted(unanswered=[Answer.GO, Answer.GO])
    sonar = Prepared(*[None] * 5, *[(1.0,)] * 5, *[None] * 10, (1.0,))
    Session(
        replace(SMALL, pings=12), DriverSource(sonar, sleep=lambda s: None), tmp_path / "r.csv", operator=operator
    ).run()
    assert operator.kinds()[:3] == ["unanswered", "ready", "unanswered"]
    assert (Recording.load(tmp_path / "r.csv").reading.status == EchoStatus.ECHO).all()


def test_single_lost_pings_are_recorded_as_no_answer(tmp_path):
    sonar = Prepared(*[(1.0,)] * 5, *[(1.0,), None, ()] * 8, (1.0,))
    session(tmp_path / "r.csv", sonar, NoOperator()).run()
    text = (tmp_path / "r.csv").read_text().splitlines()
    table = Recording.load(tmp_path / "r.csv").table
    assert table["reading_mm"].fillna(-1).tolist() == [1000.0, -1, 0.0] * 8
    assert text[2].count(",,") > 0  # no answer is an empty field, not 0
    assert ",," not in text[3]


def test_the_operator_is_asked_about_missing_echoes_before_and_during_a_session(tmp_path):
    many = replace(SMALL, distances_mm=tuple(float(d) for d in range(100, 700, 100)))
    operator = Scripted(silent=[Answer.GO, Answer.SKIP])
    source = DriverSource(Prepared(()), sleep=lambda s: None)
    Session(many, source, tmp_path / "r.csv", operator=operator).run()
    asked = [item for item in operator.asked if item[0] == "silent"]
    assert asked == [("silent", 0), ("silent", 0), ("silent", 5), ("silent", 5)]  # tested again, accepted, later twice


def test_resumed_hardware_is_another_session(tmp_path):
    path, source = tmp_path / "r.csv", twin_source()
    with pytest.raises(PowerCut):
        Session(SMALL, Failing(source, 2), path).run()
    Session(SMALL, source, path, resume=True).run()
    assert sorted(set(Recording.load(path).table["session"])) == ["0", "1"]


def test_sessions_import_no_heavy_packages():
    code = (
        "import sys, acquisition, acquisition.bench, acquisition.survey.session, acquisition.survey.sources, "
        "acquisition.drivers, acquisition.twins.devantech; "
        "print([m for m in ('torch', 'gymnasium', 'scipy', 'matplotlib', 'noise', 'rich', 'tyro') if m in sys.modules])"
    )
    root = Path(__file__).parents[3]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout.strip() == "[]"


def test_the_thermometer_is_read_again_when_its_value_is_old(tmp_path):
    file, now = tmp_path / "temperature", [0.0]
    file.write_text("21437\n")
    thermometer = Thermometer(file, clock=lambda: now[0])
    file.write_text("22000\n")
    assert thermometer() == 21.437
    now[0] = 11.0
    assert thermometer() == 22.0
    file.write_text("")
    for now[0] in (22.0, 25.0, 33.0, 44.0):  # it fails at three of these, as a 1-Wire bus may
        assert thermometer() == 22.0
    now[0] = 55.0
    with pytest.raises(DeviceError, match="temperature: reads '', expected thousandths of a degree Celsius; check its"):
        thermometer()
    file.write_text("23000")
    now[0] = 66.0
    assert thermometer() == 23.0


@pytest.mark.parametrize(("content", "message"), [("", "expected thousandths"), ("85000", "85 degC, expected -60 to")])
def test_a_thermometer_without_a_valid_value_is_an_error(tmp_path, content, message):
    file = tmp_path / "temperature"
    file.write_text(content)
    with pytest.raises(DeviceError, match=message):
        Thermometer(file)
