"""Inputs of a diagnosis: every accepted form, and a warning for every doubtful property of the data."""

import numpy as np
import pandas as pd
import pytest

from acquisition import Ping, Reading, Recording, RecordingError, SettingError, UnknownModelError, as_recording
from noise import GaussianModel, IdealModel, PhysicalModel, save_model
from noise.discrepancy.inputs import as_model, warnings_of


def recording(low=0.3, high=3.0, n=60, name="recorded", scale=1.0, angle=0.0, **columns):
    ping = Ping.of(np.linspace(low, high, n), angle=angle, time=np.arange(n) * 0.1)
    return Recording.of(ping, Reading.of(scale * ping.distance), name, **columns)


def test_a_recording_is_accepted_as_such_as_a_table_and_as_a_path(tmp_path):
    given = recording()
    path = given.save(tmp_path / "recorded.csv")
    assert as_recording(given) is given
    for other in (as_recording(given.table), as_recording(path), as_recording(str(path))):
        np.testing.assert_allclose(other.ping.distance, given.ping.distance)
        np.testing.assert_allclose(other.reading.range, given.reading.range)


def test_empty_cells_of_a_table_are_pings_without_an_answer():
    table = pd.DataFrame({"distance_mm": [1000.0, 1000.0], "angle_deg": [0, 0], "reading_mm": [1001.0, None]})
    assert as_recording(table).reading.answered.tolist() == [True, False]


def test_a_wrong_input_is_named():
    with pytest.raises(RecordingError, match="angle_deg is missing"):
        as_recording(pd.DataFrame({"distance_mm": [1.0], "reading_mm": [1.0]}))
    twins = recording().table.iloc[:, [*range(8), 0]]
    with pytest.raises(RecordingError, match="'time_s' is given twice"):
        as_recording(twins)
    with pytest.raises(RecordingError, match=r"distance_mm is missing.*found 0, 1"):
        as_recording(recording().table.set_axis(range(8), axis=1))
    with pytest.raises(SettingError, match="is a list, expected a Recording"):
        as_recording([1, 2, 3])
    with pytest.raises(SettingError, match="is a int, expected a name"):
        as_model(3)
    with pytest.raises(UnknownModelError):
        as_model("no-such-model")


def test_a_model_is_accepted_by_name_as_such_as_a_folder_and_as_a_function(tmp_path):
    gaussian = GaussianModel(0.02)
    assert isinstance(as_model("ideal"), IdealModel)
    assert as_model(gaussian) is gaussian
    assert as_model(save_model(gaussian, tmp_path / "model")) == gaussian
    assert isinstance(as_model(PhysicalModel()), PhysicalModel)

    def simulator(pings, rng):
        return pings.distance

    assert as_model(simulator) is simulator


def test_ordinary_data_have_no_warning():
    assert warnings_of(recording()) == ()
    assert warnings_of(recording(), recording(0.2, 3.2, name="simulated")) == ()


def test_units_that_look_wrong_are_warned_of():
    metres = recording()
    metres = Recording(metres.table.assign(distance_mm=metres.table.distance_mm / 1000), "recorded")
    assert any("distance_mm" in text and "metres" in text for text in warnings_of(metres))
    both = Recording(metres.table.assign(reading_mm=metres.table.reading_mm / 1000), "recorded")
    assert sum("may be in metres" in text for text in warnings_of(both)) == 2
    assert any("0.1 times distance_mm" in text for text in warnings_of(recording(scale=0.1)))
    assert warnings_of(recording(scale=1.12)) == ()
    for tiny in ("distance_mm", "reading_mm"):
        (text,) = warnings_of(Recording(recording().table.assign(**{tiny: 1e-320}), "recorded"))
        assert f"no value of {tiny} exceeds 20 mm" in text


def test_times_that_look_wrong_are_warned_of():
    n = 60
    twice = recording(time_s=np.repeat(np.arange(n / 2), 2))
    assert any("30 of 60 pings have the time stamp of the ping before" in text for text in warnings_of(twice))
    backward = recording(time_s=np.r_[np.arange(30.0), np.arange(30.0)])
    assert any("decreases within a session (rows: 1)" in text for text in warnings_of(backward))
    sessions = recording(time_s=np.r_[np.arange(30.0), np.arange(30.0)], session=["a"] * 30 + ["b"] * 30)
    assert warnings_of(sessions) == ()


def test_conditions_without_overlap_are_warned_of():
    (text,) = warnings_of(recording(0.3, 1.0), recording(2.0, 3.0, name="simulated"))
    assert "No recorded ping lies within the simulated distance (2 to 3 m; recorded: 0.3 to 1 m)" in text
    partly = warnings_of(recording(0.3, 3.0), recording(2.0, 3.0, name="simulated"))
    assert "Only 37 % of recorded pings lie" in partly[0]
    (turned,) = warnings_of(recording(), recording(angle=0.5, name="simulated"))
    assert "simulated angle (28.6 to 28.6 deg" in turned


def test_pings_without_an_answer_are_warned_of():
    given = recording()
    lost = Recording(given.table.assign(reading_mm=given.table.reading_mm.where(given.table.index > 5)), "recorded")
    assert any("6 of 60 pings had no answer" in text for text in warnings_of(lost))
