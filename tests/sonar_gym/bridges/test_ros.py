"""Readings as ROS messages: values, bags, and the node on a stand-in of rclpy."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import EchoStatus, MissingExtraError, Ping, Reading, Recording, RecordingError, SettingError
from acquisition.io.logs.bags import GroundTruthSource, import_bag, reading_mm
from noise import load_model
from sonar_gym.bridges.ros.hearing import HeardRanges, scan_sectors
from sonar_gym.bridges.ros.messages import STATUS, ideal_distances, range_values
from sonar_gym.bridges.ros.node import HeardNode, NodeSettings, Types, run_node

pytest.importorskip("rosbags", reason="needs the extra sonar-gym[ros]")
from sonar_gym.bridges.ros.bag import DIAGNOSTIC_TYPE, write_bag

MIN, MAX = 0.03, 6.0


@pytest.fixture
def recording():
    rng, n = np.random.default_rng(0), 60
    ping = Ping.of(rng.uniform(0.2, 3.0, n), 0.0, reflectance=0.9, time=0.1 * np.arange(n))
    reading = load_model("srf08-mlp").law(ping).sample(rng)
    status = reading.status.copy()
    status[7] = EchoStatus.NO_ANSWER
    reading = Reading(np.where(status == EchoStatus.ECHO, reading.range, 0.0), status)
    return Recording.of(ping, reading, sensor="front left")


def credence_in(path):
    """Return sensor, range, status and credence of each diagnostic message of a bag, as arrays."""
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        chosen = [c for c in reader.connections if c.msgtype == DIAGNOSTIC_TYPE]
        found = (
            [reader.deserialize(raw, c.msgtype).status[0] for c, _, raw in reader.messages(chosen)] if chosen else []
        )
    values = [{pair.key: pair.value for pair in status.values} for status in found]
    return (
        [status.name for status in found],
        np.array([float(v["range_m"]) for v in values]),
        np.array([STATUS[v["status"]] for v in values]),
        np.array([float(v["credence"]) for v in values]),
    )


@given(st.lists(st.tuples(st.sampled_from(list(EchoStatus)), st.floats(0.05, 5.9)), min_size=1))
def test_values_follow_rep_117_as_the_import_reads_them(pings):
    status = np.array([int(s) for s, _ in pings], np.uint8)
    reading = Reading(np.where(status == EchoStatus.ECHO, [r for _, r in pings], 0.0), status)
    value = range_values(reading, MIN)
    back, too_close = reading_mm(value, np.full(len(value), MIN), np.full(len(value), MAX))
    np.testing.assert_allclose(back, np.where(reading.answered, 1000.0 * reading.range, np.nan))
    assert not too_close.any()


@pytest.mark.parametrize("sqlite", [False, True], ids=["mcap", "sqlite"])
def test_a_recording_survives_the_way_to_a_bag_and_back(recording, tmp_path, sqlite):
    assert write_bag(recording, tmp_path / "bag", "srf08-mlp", sqlite=sqlite) == len(recording)
    truth = GroundTruthSource(topic="/sonar/front_left/true")
    back = import_bag(tmp_path / "bag", ["/sonar/front_left"], truth).recording
    np.testing.assert_allclose(back.reading.range, recording.reading.range, atol=1e-6)
    np.testing.assert_array_equal(back.reading.status, recording.reading.status)
    np.testing.assert_allclose(back.ping.distance, recording.ping.distance, atol=1e-6)
    np.testing.assert_allclose(back.ping.time, recording.ping.time, atol=1e-6)
    assert set(back.table["sensor"]) == {"front left"}
    sensor, range_, status, credence = credence_in(tmp_path / "bag")
    np.testing.assert_array_equal(status, recording.reading.status)
    echo = status == EchoStatus.ECHO
    np.testing.assert_allclose(range_[echo], recording.reading.range[echo], rtol=1e-5)
    assert np.all(credence[~echo] == 0.0)
    assert credence[echo].mean() > 0.5
    assert set(sensor) == {"front left"}


def test_topics_are_valid_in_ros_2_and_one_for_each_sensor(recording, tmp_path):
    from rosbags.highlevel import AnyReader

    nameless = Recording.of(recording.ping, recording.reading)
    write_bag(nameless, tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        assert set(reader.topics) == {"/sonar/sensor_0", "/sonar/sensor_0/true"}
    sensor = np.where(np.arange(len(recording)) % 2, "front left", "front-left")
    twice = Recording.of(recording.ping, recording.reading, sensor=sensor)
    with pytest.raises(RecordingError, match="'front-left' and 'front left' would both be on /sonar/front_left: ren"):
        write_bag(twice, tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_a_bag_without_a_model_has_no_credence_and_a_folder_that_exists_is_named(recording, tmp_path):
    write_bag(recording, tmp_path / "bag")
    assert credence_in(tmp_path / "bag")[0] == []
    with pytest.raises(SettingError, match="exists; give the name of a new folder"):
        write_bag(recording, tmp_path / "bag")


def test_sectors_hold_the_nearest_return_and_its_bearing():
    ranges = np.array([2.0, 1.0, np.inf, np.nan, np.nan, np.nan, 3.0, 9.0])
    distance, bearing = scan_sectors(ranges, -0.35, 0.1, 5.0, 4)
    np.testing.assert_allclose(distance, [1.0, np.inf, np.nan, 3.0])
    np.testing.assert_allclose(bearing, [0.05, 0.0, 0.0, -0.05])
    with pytest.raises(SettingError, match="count: expected a whole number from 1 to 8, got 9"):
        scan_sectors(ranges, 0.0, 0.1, 5.0, 9)


@given(st.lists(st.sampled_from([-np.inf, 0.0, 0.05, 0.3, 1.0, 4.0, np.inf, np.nan]), min_size=1, max_size=8))
def test_a_return_of_a_scan_is_as_far_as_the_same_range(ranges):
    distance, _ = scan_sectors(np.array(ranges), 0.0, 0.1, 4.0, len(ranges), 0.1)
    np.testing.assert_array_equal(distance, ideal_distances(np.array(ranges), 0.1, 4.0))


@given(st.lists(st.floats(0.0, 20.0), min_size=4, max_size=60), st.integers(1, 4))
def test_the_nearest_of_all_sectors_is_the_nearest_of_the_scan(ranges, count):
    distance, _ = scan_sectors(np.array(ranges), 0.0, 0.1, 30.0, count)
    assert distance.min() == min(ranges)


def test_ideal_ranges_are_heard_and_missing_ones_left_out():
    heard = HeardRanges("ideal", MAX, 0.5, 0)
    distance = ideal_distances(np.array([1.0, np.inf, np.nan]), MIN, MAX)
    names, reading, credence = heard.hear(["a", "b", "c"], distance, np.zeros(3), 1.0)
    assert names == ["a", "b"]
    assert reading.status.tolist() == [EchoStatus.ECHO, EchoStatus.NO_ECHO]
    assert reading.range[0] == pytest.approx(1.0)
    assert credence.tolist() == [1.0, 0.0]
    with pytest.raises(SettingError, match="reflectance"):
        HeardRanges("ideal", MAX, 1.5, 0)


def message(**fields):
    return SimpleNamespace(**fields)


def empty():
    return message(header=message(stamp=None, frame_id=""), status=[], values=[])


class StandIn:
    """The methods of an rclpy node that the bridge uses."""

    def __init__(self, **parameters):
        self.parameters, self.published, self.callbacks = parameters, {}, {}

    def declare_parameter(self, name, default):
        return message(value=self.parameters.get(name, default))

    def create_publisher(self, kind, topic, qos):
        return message(publish=self.published.setdefault(topic, []).append)

    def create_subscription(self, kind, topic, callback, qos):
        self.callbacks[topic] = callback


TYPES = Types(empty, empty, empty, empty, empty)
HEADER = message(stamp=message(sec=12, nanosec=5), frame_id="bumper")


def test_the_node_publishes_what_the_sonar_reads_with_its_credence():
    node = StandIn(model="ideal")
    HeardNode(node, ["/front"], NodeSettings(), TYPES, None)
    for value in (1.5, math.inf, math.nan):
        node.callbacks["/front"](
            message(header=HEADER, range=value, min_range=0.02, max_range=4.0, field_of_view=0.5)
        )  # fmt: skip
    first, second = node.published["/front/heard"]
    assert first.range == pytest.approx(1.5)
    assert (first.header.stamp, first.header.frame_id, first.field_of_view) == (HEADER.stamp, "bumper", 0.5)
    assert (first.min_range, first.max_range, first.radiation_type) == (MIN, MAX, 0)
    assert second.range == math.inf
    status = node.published["/front/heard/credence"][0].status[0]
    assert (status.name, status.message, status.level) == ("bumper", "echo", b"\0")
    assert {pair.key: pair.value for pair in status.values} == {"credence": "1", "status": "echo", "range_m": "1.5"}


def test_a_scan_is_heard_in_sectors():
    node = StandIn(model="ideal", sectors=2)
    HeardNode(node, ["/scan:LaserScan"], NodeSettings(), TYPES, None)
    scan = message(
        header=HEADER, ranges=[1.0, 2.0, 3.0, 4.0], angle_min=0.0, angle_increment=0.1, range_min=0.1, range_max=5.0
    )
    node.callbacks["/scan"](scan)
    out = node.published["/scan/heard"]
    assert [round(m.range, 6) for m in out] == [1.0, 3.0]
    assert [m.header.frame_id for m in out] == ["bumper_sector_0", "bumper_sector_1"]
    assert out[0].field_of_view == pytest.approx(0.2)
    scan.ranges = [1.0, 2.0, 3.0, -math.inf]  # too close to measure
    node.callbacks["/scan"](scan)
    assert [round(m.range, 6) for m in out[2:]] == [1.0, 0.1]


def test_without_ros_the_node_says_what_it_needs(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(MissingExtraError, match="needs 'rclpy' of ROS 2"):
        run_node(["/front"], NodeSettings())
    with pytest.raises(SettingError, match="expected one topic or more"):
        HeardNode(StandIn(), [], NodeSettings(), TYPES, None)


def test_credence_in_the_bag_is_that_of_the_table(recording, tmp_path):
    write_bag(recording, tmp_path / "bag", "gaussian")
    _, range_, status, credence = credence_in(tmp_path / "bag")
    echo = status == EchoStatus.ECHO
    assert np.corrcoef(credence[echo], range_[echo])[0, 1] > 0.0  # 1 cm matters less far away
