"""Import of ROS bags, which the tests write with rosbags."""

import math
import sys

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import EchoStatus, MissingExtraError, RecordingError, RecordingNotFoundError, SettingError
from acquisition.io.logs.bags import GroundTruthSource, TimeSeries, import_bag, is_bag, read_table, reading_mm

rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="needs the extra sonar-gym[ros]")
from rosbags import rosbag2  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

BEGAN = 1_700_000_000  # s
KINDS = ("ros1", "sqlite", "mcap", "jazzy")
STORES = {"ros1": Stores.ROS1_NOETIC, "jazzy": Stores.ROS2_JAZZY}


class Bag:
    """Writer of messages of one ROS version to one kind of bag."""

    def __init__(self, folder, kind="ros1"):
        self.kind, self.store = kind, get_typestore(STORES.get(kind, Stores.ROS2_HUMBLE))
        self.path = folder / ("log.bag" if kind == "ros1" else "log")
        plugin = rosbag2.StoragePlugin.SQLITE3 if kind == "sqlite" else rosbag2.StoragePlugin.MCAP
        self.writer = (
            rosbag1.Writer(self.path) if kind == "ros1" else rosbag2.Writer(self.path, version=9, storage_plugin=plugin)
        )
        self.connections = {}

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *_):
        self.writer.close()

    def make(self, kind, *values, **named):
        return self.store.types[kind](*values, **named)

    def header(self, stamp, frame):
        sec, nanosec = divmod(round(stamp * 1e9), 10**9)
        time = self.make("builtin_interfaces/msg/Time", sec, nanosec)
        extra = {"seq": 0} if self.kind == "ros1" else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **extra)

    def range(self, topic, stamp, value, frame="front", least=0.02, most=4.0, infrared=False, received=None):
        extra = {"variance": 0.0} if self.kind == "jazzy" else {}
        message = self.make(
            "sensor_msgs/msg/Range",
            header=self.header(stamp, frame),
            radiation_type=int(infrared),
            field_of_view=0.5,
            min_range=least,
            max_range=most,
            range=value,
            **extra,
        )
        self.write(topic, message, stamp if received is None else received)

    def pose(self, topic, stamp, x, y=0.0, z=0.0):
        pose = self.make(
            "geometry_msgs/msg/Pose",
            position=self.make("geometry_msgs/msg/Point", x, y, z),
            orientation=self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0),
        )
        self.write(topic, self.make("geometry_msgs/msg/PoseStamped", self.header(stamp, "map"), pose), stamp)

    def write(self, topic, message, stamp):
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialise = self.store.serialize_ros1 if self.kind == "ros1" else self.store.serialize_cdr
        self.writer.write(self.connections[topic], round(stamp * 1e9), serialise(message, kind))


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_gives_the_same_recording(tmp_path, kind):
    with Bag(tmp_path, kind) as bag:
        for k, value in enumerate([1.0, 2.5, math.inf, 4.0, 5.0, 0.0, math.nan, -math.inf, 0.01]):
            bag.range("/sonar", BEGAN + 0.1 * k, value)
    assert is_bag(bag.path)
    imported = import_bag(bag.path, constants={"distance_mm": 1000.0, "reflectance": 0.9})
    recording = imported.recording
    echo, none, lost = EchoStatus.ECHO, EchoStatus.NO_ECHO, EchoStatus.NO_ANSWER
    assert recording.reading.status.tolist() == [echo, echo, none, none, none, none, lost, lost, lost]
    assert recording.reading.range[:2].tolist() == [1.0, 2.5]
    assert (imported.left_out, imported.too_close) == (0, 2)
    np.testing.assert_allclose(recording.ping.time, 0.1 * np.arange(9), atol=1e-6)
    assert set(recording.table["sensor"]) == {"front"}
    assert recording.ping.covariates["field_of_view_deg"][0] == pytest.approx(np.degrees(0.5), abs=1e-4)
    assert recording.ping.reflectance.tolist() == [0.9] * 9
    assert recording.ping.angle.tolist() == [0.0] * 9


def test_one_file_of_a_ros_2_folder_is_enough(tmp_path):
    with Bag(tmp_path, "mcap") as bag:
        bag.range("/sonar", BEGAN, 1.0)
    file = next(bag.path.glob("*.mcap"))
    assert len(import_bag(file, constants={"distance_mm": 1000.0}).recording) == 1


def test_topics_are_chosen_and_frames_are_sensors(tmp_path):
    with Bag(tmp_path) as bag:
        for k in range(4):
            bag.range("/left", BEGAN + k, 1.0, frame="left")
            bag.range("/right", BEGAN + k + 0.5, 2.0, frame="")
            bag.range("/floor", BEGAN + k, 0.3, frame="floor", infrared=True)
    whole = import_bag(bag.path, constants={"distance_mm": 1000.0}).recording
    assert whole.table["sensor"].tolist() == ["left", "/right"] * 4
    assert whole.run.tolist() == [0, 1] * 4
    one = import_bag(bag.path, ["/floor"], constants={"distance_mm": 300.0}).recording
    assert set(one.table["sensor"]) == {"floor"}
    with pytest.raises(RecordingError, match=r"topic '/rear' is not one of /floor, /left, /right"):
        import_bag(bag.path, ["/rear"], constants={"distance_mm": 300.0})


def test_a_message_without_a_stamp_has_the_time_it_was_received(tmp_path):
    with Bag(tmp_path) as bag:
        for k in range(3):
            bag.range("/sonar", 0.0, 1.0, received=BEGAN + 2.0 * k)
    recording = import_bag(bag.path, constants={"distance_mm": 1000.0}).recording
    np.testing.assert_allclose(recording.ping.time, [0.0, 2.0, 4.0], atol=1e-6)


def test_true_distance_from_a_laser(tmp_path):
    with Bag(tmp_path, "mcap") as bag:
        for k in range(11):
            bag.range("/laser", BEGAN + 0.1 * k, 1.0 + 0.1 * k if k != 5 else math.inf, infrared=True, most=30.0)
        for k in range(10):
            bag.range("/sonar", BEGAN + 0.1 * k + 0.05, 1.1)
        bag.range("/sonar", BEGAN + 5.0, 1.1)  # after the last true distance
    imported = import_bag(bag.path, truth=GroundTruthSource("/laser"))
    assert imported.left_out == 1
    # the laser's missing value is interpolated, because the gap is short
    np.testing.assert_allclose(imported.recording.ping.distance, 1.05 + 0.1 * np.arange(10), atol=1e-5)
    strict = import_bag(bag.path, truth=GroundTruthSource("/laser", longest_gap_s=0.15))
    assert strict.left_out == 3


def test_true_distance_from_a_position(tmp_path):
    with Bag(tmp_path, "sqlite") as bag:
        for k in range(5):
            bag.pose("/robot", BEGAN + k * 0.25, x=0.5 * k, y=1.0)
            bag.range("/sonar", BEGAN + k * 0.25, 1.0)
    recording = import_bag(bag.path, truth=GroundTruthSource("/robot", point=(5.0, 1.0, 0.0))).recording
    np.testing.assert_allclose(recording.ping.distance, 5.0 - 0.5 * np.arange(5), atol=1e-6)
    with pytest.raises(SettingError, match=r"/robot: is a position; give the point of the reflector"):
        import_bag(bag.path, truth=GroundTruthSource("/robot"))


def test_true_distance_from_a_table(tmp_path):
    with Bag(tmp_path) as bag:
        for k in range(3):
            bag.range("/sonar", BEGAN + k, 1.0)
    table = tmp_path / "truth.csv"
    for clock, began in (("time_s", 0.0), ("stamp_s", float(BEGAN))):
        table.write_text(f"{clock},distance_cm,angle_deg\n{began},100,0\n{began + 1},200,10\n{began + 2},200,10\n")
        recording = import_bag(bag.path, truth=GroundTruthSource(table=table, longest_gap_s=2.0)).recording
        assert recording.ping.distance.tolist() == pytest.approx([1.0, 2.0, 2.0])
        assert np.degrees(recording.ping.angle).tolist() == pytest.approx([0.0, 10.0, 10.0])
    table.write_text("time_s,distance_m\n900,1\n901,1\n")
    with pytest.raises(
        RecordingError, match=r"no ping lies within 0.5 s of a true distance; check that both use the same cl"
    ):
        import_bag(bag.path, truth=GroundTruthSource(table=table))


def test_a_constant_replaces_what_the_import_adds_and_nothing_else(tmp_path):
    with Bag(tmp_path) as bag:
        bag.range("/sonar", BEGAN, 1.0)
    constants = {"distance_mm": 1000.0, "session": "morning", "time_s": 5.0, "angle_deg": 10.0}
    table = import_bag(bag.path, constants=constants).recording.table
    assert table[list(constants)].to_dict("records") == [constants]
    (tmp_path / "truth.csv").write_text("time_s,distance_m\n0,2\n1,2\n")
    truth = GroundTruthSource(table=tmp_path / "truth.csv", longest_gap_s=2.0)
    with pytest.raises(SettingError, match="column distance_mm: is given 2 times"):
        import_bag(bag.path, truth=truth, constants=constants)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("when,distance_m\n0,1\n", "line 1: expected time_s or stamp_s and one or more of distance_m"),
        ("time_s,range\n0,1\n", "line 1: expected time_s or stamp_s and one"),
        ("time_s,distance_m\n0,1\n1,x\n", "line 3, column distance_m: expected a number"),
        ("time_s,distance_m\n", "line 2, column time_s: expected a number"),
        ("time_s,distance_m\n1,1\n1,2\n", "line 3, column time_s: expected a larger value than in the previous line"),
    ],
)
def test_a_faulty_table_is_an_error_with_its_line(tmp_path, text, message):
    table = tmp_path / "truth.csv"
    table.write_text(text)
    with pytest.raises(RecordingError, match=message):
        read_table(table, 0.0)


@pytest.mark.parametrize("kind", ["ros1", "sqlite", "mcap"])
def test_a_corrupt_bag_is_a_recording_error(tmp_path, kind):
    with Bag(tmp_path, kind) as bag:
        for k in range(200):
            bag.range("/sonar", BEGAN + k, 1.0)
    file = bag.path if kind == "ros1" else next(bag.path.glob("*.mcap" if kind == "mcap" else "*.db3"))
    whole = file.read_bytes()
    for keep in (0, 10, len(whole) // 3, len(whole) // 2):
        file.write_bytes(whole[:keep])
        with pytest.raises(RecordingError, match="not a readable bag: ") as caught:
            import_bag(bag.path, constants={"distance_mm": 1.0})
        assert "\n" not in str(caught.value)
    file.write_bytes(whole[:-20])
    try:
        recording = import_bag(bag.path, constants={"distance_mm": 1.0}).recording
    except RecordingError:
        return
    assert len(recording) == 200  # the lost bytes hold no message


@pytest.mark.skipif(sys.platform != "linux", reason="needs a limit of the address space")
def test_a_bag_that_expands_without_end_takes_bounded_memory(tmp_path, monkeypatch):
    import resource

    bag = Bag(tmp_path)
    bag.writer.set_compression(rosbag1.Writer.CompressionFormat.LZ4)
    with bag:
        bag.range("/sonar", BEGAN, 1.0, frame="x" * 2**25)
    assert bag.path.stat().st_size < 2**20
    assert len(import_bag(bag.path, constants={"distance_mm": 1000.0}).recording) == 1
    monkeypatch.setattr("acquisition.io.logs.bags.MAX_MEMORY", 2**24)
    before = resource.getrlimit(resource.RLIMIT_AS)
    with pytest.raises(RecordingError, match="not a readable bag: it takes more than"):
        import_bag(bag.path, constants={"distance_mm": 1000.0})
    assert resource.getrlimit(resource.RLIMIT_AS) == before


def test_a_bag_without_sonars_is_an_error(tmp_path):
    with pytest.raises(RecordingNotFoundError, match="no such bag"):
        import_bag(tmp_path / "no.bag", constants={"distance_mm": 1.0})
    with Bag(tmp_path) as bag:
        bag.pose("/robot", BEGAN, 1.0)
    with pytest.raises(RecordingError, match=r"no topic of sensor_msgs/Range; found /robot \(geometry_msgs/msg/Pose"):
        import_bag(bag.path, constants={"distance_mm": 1.0})
    with pytest.raises(SettingError, match="a bag has no true distance; give a constant distance_mm, a topic or a t"):
        import_bag(bag.path)


def test_a_missing_library_is_an_error_with_the_extra(tmp_path, monkeypatch):
    (tmp_path / "log.bag").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'sonar-gym\[ros\]'"):
        import_bag(tmp_path / "log.bag", constants={"distance_mm": 1.0})


any_range = st.floats(allow_nan=True, allow_infinity=True, width=32)


@given(any_range, st.floats(0, 1), st.floats(1, 10))
def test_every_range_is_an_echo_no_echo_or_no_answer(value, least, most):
    reading, too_close = reading_mm(np.array([value]), np.array([least]), np.array([most]))
    if least <= value < most and value > 0:
        assert reading[0] == pytest.approx(value * 1000.0)
    elif value >= most or value == 0:
        assert reading[0] == 0.0
    else:
        assert np.isnan(reading[0])
        assert too_close[0] == (not math.isnan(value))


def test_no_extrapolation_and_no_interpolation_across_long_gaps():
    known = TimeSeries(np.array([0.0, 1.0, 5.0]), {"x": np.array([0.0, 10.0, 50.0])})
    got = known.interpolate(np.array([-0.1, 0.0, 0.5, 1.0, 3.0, 5.0, 5.1]), 1.0)["x"]
    np.testing.assert_array_equal(got, [np.nan, 0.0, 5.0, 10.0, np.nan, 50.0, np.nan])
    alone = TimeSeries(np.array([2.0]), {"x": np.array([7.0])}).interpolate(np.array([1.0, 2.0]), 1.0)["x"]
    np.testing.assert_array_equal(alone, [np.nan, 7.0])


def test_a_csv_file_is_not_a_bag(tmp_path):
    pd.DataFrame({"a": [1]}).to_csv(tmp_path / "log.csv")
    assert not is_bag(tmp_path / "log.csv")
    assert not is_bag(tmp_path)
