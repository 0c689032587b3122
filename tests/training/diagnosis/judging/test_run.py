"""Runs are reproducible and go on where they stopped; halves of real recordings hold the planted change."""

import copy
import json

import numpy as np
import pandas as pd
import pytest

from acquisition import Recording, RecordingError
from noise.fitting.batch import Batch
from training.diagnosis.judging import real
from training.diagnosis.judging.record import ensemble_crps, overlap, scores
from training.diagnosis.judging.run import RECORDS, append, read, run
from training.diagnosis.judging.tasks import case_of, trials


def ended(id_, value):
    """Return the record of a diagnosis that ended in an error."""
    head = {"family": "beam", "kind": "same", "number": 0, "seed": 0, "pings": 60, "commit": "0", "n": 60}
    return {**head, "id": id_, "causes": [], "fault": "", "error": "stub", "value": value}


def stub(task):
    return ended(task.id, task.rng().random())


def test_an_interrupted_run_goes_on_and_gives_what_an_uninterrupted_one_gives(tmp_path):
    tasks = trials(("beam", "fixed"), ("same", "single"), 2, 0, 60)
    whole = run(tasks, tmp_path / "whole", 1, stub)
    run(tasks[:3], tmp_path / "part", 1, stub)
    with (tmp_path / "part" / RECORDS).open("a") as file:
        file.write('{"id": "beam/sa')  # the machine stopped while a line was written
    calls = []
    again = run(tasks, tmp_path / "part", 1, lambda task: calls.append(task) or stub(task))
    assert calls == tasks[3:]
    assert again == whole
    assert all(json.loads(line) for line in (tmp_path / "part" / RECORDS).read_text().splitlines())


def test_the_last_record_of_a_task_counts(tmp_path):
    for value in (1, 2):
        append(tmp_path / RECORDS, ended("a", value))
    assert read(tmp_path) == [ended("a", 2)]


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("scores",), {"before": 0.1}),
        (("verdict", "p_value"), [1]),
        (("causes",), 0.5),
        (("evidence", "zero_offset"), {}),
        (("id",), None),
    ],
)
def test_a_damaged_record_or_one_of_another_version_is_named(tmp_path, record, place, value):
    good = record()
    append(tmp_path / RECORDS, good)
    assert read(tmp_path) == [good]
    bad = copy.deepcopy(good)
    inner = bad
    for name in place[:-1]:
        inner = inner[name]
    inner[place[-1]] = value
    append(tmp_path / RECORDS, bad)
    with pytest.raises(RecordingError, match=rf"line 2: no record of a trial by this version \({place[0]}"):
        read(tmp_path)


def test_a_line_nested_too_deeply_is_named(tmp_path, record):
    append(tmp_path / RECORDS, record())
    with (tmp_path / RECORDS).open("a") as file:
        file.write("[" * 100_000 + "\n")
    with pytest.raises(RecordingError, match="line 2: no record of a trial"):
        read(tmp_path)


def test_a_task_fixes_its_data():
    first, second, other = (case_of(trials(("beam",), ("single",), 2, 0, 60)[k]) for k in (0, 0, 1))
    assert np.array_equal(first.recorded.reading.range, second.recorded.reading.range)
    assert first.causes == second.causes
    assert not np.array_equal(first.recorded.reading.range, other.recorded.reading.range)
    assert len(first.fresh) == 3


def survey(visits):
    mark = np.repeat(np.tile([400.0, 800.0, 1200.0], visits // 3), 20)
    session = np.repeat(np.arange(visits), 20).astype(str)
    reading = mark + np.random.default_rng(0).integers(-2, 3, len(mark))
    return pd.DataFrame({"session": session, "distance_mm": mark, "angle_deg": 0.0, "reading_mm": reading})


@pytest.mark.parametrize("visits", [3, 12])
def test_each_half_holds_every_condition(visits):
    table = survey(visits)
    first = real.half_of(Recording(table, "a"))
    assert first.sum() == len(table) / 2
    assert set(table.distance_mm[first]) == set(table.distance_mm[~first])
    shared = set(table.session[first]) & set(table.session[~first])
    assert len(shared) == (3 if visits == 3 else 0)


@pytest.mark.parametrize("change", real.CHANGES)
def test_a_planted_change_is_in_one_half_and_of_its_size(change, monkeypatch, tmp_path):
    monkeypatch.setitem(real.READERS, "made", ("", lambda folder: survey(120)))
    plain, _, _ = real.planted(tmp_path, "made: as it is", np.random.default_rng(1))
    first, second, causes = real.planted(tmp_path, f"made: {change}", np.random.default_rng(1))
    assert np.array_equal(first.reading.range, plain.reading.range)
    error = second.reading.range - second.ping.distance
    assert len(causes) == (change != "as it is")
    if change == "+12 mm":
        assert np.mean(error) == pytest.approx(0.012, abs=3e-4)
    if change == "+1.5 %":
        assert np.mean(error / second.ping.distance) == pytest.approx(0.015, abs=3e-4)
    if change == "6 % lost":
        assert np.mean(~second.reading.echo) == pytest.approx(0.06, abs=0.03)
    if change == "4 % spikes":
        assert np.mean(np.abs(error) > 0.01) == pytest.approx(0.04, abs=0.02)


@pytest.mark.parametrize("step_mm", [0.17, 1.0, 10.0])
def test_no_change_leaves_the_readings_of_any_register(step_mm, monkeypatch, tmp_path):
    table = survey(120)
    table.reading_mm = step_mm * (table.reading_mm / step_mm).round()
    monkeypatch.setitem(real.READERS, "made", ("", lambda folder: table))
    halves = real.planted(tmp_path, "made: as it is", np.random.default_rng(1))[:2]
    kept = np.sort(np.concatenate([half.reading.range for half in halves]))
    assert kept == pytest.approx(np.sort(table.reading_mm) / 1000.0, abs=1e-12)


def test_real_recordings_can_be_halved(real_recordings):
    names = list(real.cases(real_recordings))
    assert len(names) == len(real.READERS) * len(real.CHANGES)
    for name in names[:: len(real.CHANGES)]:
        first, second, _ = real.planted(real_recordings, name, np.random.default_rng(0))
        assert 0.85 < len(first) / len(second) < 1.15, name


def test_overlap_counts_pings():
    table = survey(3).assign(distance_mm=np.linspace(0.0, 999.0, 60) + 1.0)
    batch = Batch.of(Recording(table, "a"))
    here = {"distance": (0.0, 0.5)}
    assert overlap(batch, here, {}) == pytest.approx(0.5)
    assert overlap(batch, here, {"distance": (0.25, 0.5)}) == pytest.approx(0.5)
    assert overlap(batch, {"previous_reading": (0.0, 1.0)}, {}) is None


def test_silence_hides_no_error_of_range_within_the_tolerance():
    """Half the readings of both are silent, which ones by chance; 20 mm of bias are all that differs."""
    rng, table = np.random.default_rng(3), survey(120)
    silent = [rng.random(len(table)) < 0.5 for _ in range(3)]
    recording, again, biased = (
        Recording(table.assign(reading_mm=np.where(gone, 0.0, table.reading_mm + shift)), "a")
        for gone, shift in zip(silent, (0.0, 0.0, 20.0), strict=True)
    )
    found = scores(dict.fromkeys(("corrected", "causes_only", "difference")), (recording, biased, again))
    plain, near = ((part["before"] - part["again"]) / part["gap_error"] for part in (found, found["near"]))
    assert abs(plain) < 2.0 < 5.0 < near
    assert found["near"]["before"] < 0.1 * 1.2  # no error is more than a tenth of the greatest distance


def test_a_score_within_the_tolerance_clips_readings_to_it():
    """Every reading is 500 mm late at 400 to 1200 mm: the error is the tolerance, a tenth of the distance."""
    table = survey(12)
    exact, late = (Recording(table.assign(reading_mm=table.distance_mm + by), "a") for by in (0.0, 500.0))
    found = ensemble_crps(exact, late, tolerance=0.1)
    assert found == pytest.approx(0.1 * Batch.of(exact).ping.distance)
    assert ensemble_crps(exact, late) == pytest.approx(np.full(len(found), 0.5))


def test_the_ensemble_score_is_that_of_the_law_that_drew_the_ensemble():
    """Gneiting and Raftery (2007): under N(0, s) the mean CRPS of the law itself is s / sqrt(pi)."""
    rng = np.random.default_rng(2)
    table = survey(120)
    drawn = [table.assign(reading_mm=table.distance_mm + rng.normal(0.0, 5.0, len(table))) for _ in range(3)]
    recording, again, shifted = (Recording(each, "a") for each in drawn)
    assert np.mean(ensemble_crps(recording, again)) == pytest.approx(0.005 / np.sqrt(np.pi), rel=0.05)
    moved = Recording(drawn[2].assign(reading_mm=drawn[2].reading_mm + 20.0), "a")
    assert np.mean(ensemble_crps(recording, moved)) > 3.0 * np.mean(ensemble_crps(recording, shifted))
