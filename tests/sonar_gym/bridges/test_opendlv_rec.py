"""`.rec` files of OpenDLV into recordings and back."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import Ping, Reading, Recording, RecordingError, RecordingNotFoundError, SettingError
from acquisition.io.logs.bags import TimeSeries
from sonar_gym.bridges.opendlv import encode
from sonar_gym.bridges.opendlv.messages import FRAME, READING
from sonar_gym.bridges.opendlv.rec import Geometry, read_rec, recording_of, write_rec
from sonar_gym.bridges.opendlv.session import time_of
from sonar_gym.bridges.opendlv.sonar import KIWI
from sonar_gym.sensing.scene import Scene, WallSegment

START = 1_650_000_000.0
PERIOD = 0.1


def message(name, fields, at, stamp=0):
    return encode(name, fields, sender_stamp=stamp, sent=time_of(at), received=time_of(at), sampled=time_of(at))


def table_of(recording):
    ping = recording.ping
    columns = {"distance_mm": 1000 * ping.distance, "angle_deg": np.degrees(ping.angle)}
    return TimeSeries(START + ping.time, columns)


readings = st.lists(st.one_of(st.just(0.0), st.integers(3, 600).map(lambda cm: cm / 100)), min_size=1, max_size=30)


@given(readings)
def test_a_recording_survives_the_way_to_rec_and_back(values):
    values = [1.0, *values, 2.0]  # silence before the first and after the last echo leaves no trace
    n = len(values)
    ping = Ping.of(np.linspace(0.5, 3.0, n), 0.1, time=PERIOD * np.arange(n))
    recording = Recording.of(ping, Reading.of(values), sensor="3")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.rec"
        assert write_rec(recording, path, START) == np.count_nonzero(values)
        back = recording_of(path, table_of(recording), PERIOD)
    assert set(back.table["sensor"].astype(float)) == {3.0}
    np.testing.assert_allclose(back.reading.range, recording.reading.range, atol=1e-6)
    np.testing.assert_array_equal(back.reading.status, recording.reading.status)
    np.testing.assert_allclose(back.ping.distance, ping.distance, atol=1e-5)
    np.testing.assert_allclose(back.ping.time, ping.time, atol=2e-6)


def test_true_distances_follow_from_frames_and_a_map(tmp_path):
    path = tmp_path / "drive.rec"
    data = [message(FRAME, {"x": 0.1 * k}, START + 0.1 * k) for k in range(11)]
    data += [message(FRAME, {"x": 9.0}, START + 0.05, stamp=4)]  # another car
    data += [message(READING, {"distance": 1.5}, START + 0.1 * k + 0.05) for k in range(10)]
    data += [message(READING, {"distance": 1.5}, START + 50.0)]  # without a Frame close in time
    path.write_bytes(b"".join(data))
    geometry = Geometry(Scene([WallSegment(3.0, -1.0, 3.0, 1.0)]), KIWI)
    recording = recording_of(path, geometry)
    assert len(recording) == 10
    driven = 0.1 * np.arange(10) + 0.05
    np.testing.assert_allclose(recording.ping.distance, 3.0 - KIWI[0].x - driven, atol=1e-5)
    np.testing.assert_allclose(recording.ping.angle, 0.0, atol=1e-9)
    np.testing.assert_allclose(recording.reading.range, 1.5)


def test_doubled_messages_count_once_and_values_that_are_no_distance_not_at_all(tmp_path):
    path = tmp_path / "drive.rec"
    data = [message(READING, {"distance": 1.0}, START)] * 2
    data += [message(READING, {"distance": value}, START + 1.0 + k) for k, value in enumerate((np.nan, -1.0, np.inf))]
    path.write_bytes(b"".join(data))
    assert len(recording_of(path, constants={"distance_mm": 1000.0})) == 1
    path.write_bytes(message(READING, {"distance": np.nan}, START))
    with pytest.raises(RecordingError, match="no reading lies within"):
        recording_of(path, period_s=0.1, constants={"distance_mm": 1000.0})


def test_a_period_far_below_that_of_the_readings_is_named(tmp_path):
    path = tmp_path / "drive.rec"
    path.write_bytes(b"".join(message(READING, {"distance": 1.0}, START + k) for k in range(3)))
    with pytest.raises(SettingError, match=r"period: 1e-09 s leaves more than 1,000,000 pings without an echo"):
        recording_of(path, period_s=1e-9, constants={"distance_mm": 1000.0})


def test_an_envelope_that_was_cut_off_is_left_out(tmp_path):
    path = tmp_path / "drive.rec"
    whole = message(READING, {"distance": 1.0}, START)
    for cut in range(len(whole)):
        path.write_bytes(whole + whole[:cut])
        assert len(list(read_rec(path))) == 1


def test_the_first_byte_that_begins_no_envelope_is_named(tmp_path):
    path = tmp_path / "drive.rec"
    whole = message(READING, {"distance": 1.0}, START)
    path.write_bytes(whole + b"noise")
    with pytest.raises(RecordingError, match=f"byte {len(whole)}: expected the beginning of an envelope"):
        list(read_rec(path))


def test_what_is_missing_is_named(tmp_path):
    path = tmp_path / "drive.rec"
    with pytest.raises(RecordingNotFoundError, match="no such file"):
        list(read_rec(path))
    path.write_bytes(message(READING, {"distance": 1.0}, START))
    with pytest.raises(SettingError, match="has no true distance; give a map, a table"):
        recording_of(path)
    with pytest.raises(RecordingError, match=r"has no opendlv\.sim\.Frame with senderStamp 0"):
        recording_of(path, Geometry(Scene([WallSegment(3.0, -1.0, 3.0, 1.0)]), KIWI))
    path.write_bytes(message(FRAME, {"x": 1.0}, START))
    with pytest.raises(RecordingError, match=r"has no opendlv\.proxy\.DistanceReading"):
        recording_of(path, constants={"distance_mm": 1000.0})


def test_sensors_are_numbered_by_their_names_or_places(tmp_path):
    ping, reading = Ping.of([1.0, 1.0], time=[0.0, 0.1]), Reading.of([1.0, 1.0])
    for names, stamps in ((["7", "2"], [7, 2]), (["front", "rear"], [0, 1])):
        path = tmp_path / "drive.rec"
        write_rec(Recording.of(ping, reading, sensor=names), path, START)
        assert [envelope.sender_stamp for envelope in read_rec(path)] == stamps
