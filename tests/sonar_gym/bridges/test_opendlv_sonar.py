"""This project's sonar on a car of an OpenDLV session."""

import threading

import numpy as np
import pytest

from acquisition import RecordingError, RecordingNotFoundError, SettingError
from noise import GaussianModel
from sonar_gym.bridges.opendlv.messages import FRAME, READING
from sonar_gym.bridges.opendlv.session import seconds_of
from sonar_gym.bridges.opendlv.sonar import KIWI, HeardWalls, SensorSettings, SonarService, updated_pose
from sonar_gym.bridges.opendlv.walls import ORIGIN, load_map
from sonar_gym.bridges.opendlv.wire import Envelope
from sonar_gym.sensing.scene import Scene, WallSegment

AHEAD = Scene([WallSegment(2.0, -1.0, 2.0, 1.0)])
ALL = np.ones(len(KIWI), np.bool_)
FAST = SensorSettings(frequency_hz=20.0, latency_s=0.02)


def test_the_front_sonar_reads_the_wall_from_its_place_on_the_car_and_the_others_are_silent():
    (echo,) = HeardWalls(AHEAD, "ideal", KIWI, SensorSettings()).ping(ORIGIN, ALL, 1.0)
    assert (echo.sensor, echo.ping_s) == (0, 1.0)
    assert echo.distance == pytest.approx(2.0 - KIWI[0].x)


def test_the_pose_of_the_frame_moves_and_turns_the_sonars():
    heard = HeardWalls(AHEAD, "ideal", KIWI, SensorSettings())
    (rear,) = heard.ping((0.5, 0.0, np.pi), ALL, 1.0)
    assert (rear.sensor, round(rear.distance, 6)) == (2, round(1.5 + KIWI[2].x, 2))
    assert heard.ping((-5.0, 0.0, 0.0), ALL, 2.0) == []  # the wall is beyond 6 m


@pytest.mark.parametrize(("step", "distance"), [(0.01, 1.64), (0.05, 1.65), (0.0, 1.637)])
def test_distances_are_published_in_steps(step, distance):
    walls = Scene([WallSegment(1.997, -1.0, 1.997, 1.0)])
    (echo,) = HeardWalls(walls, "ideal", KIWI, SensorSettings(step_m=step)).ping(ORIGIN, ALL, 1.0)
    assert echo.distance == pytest.approx(distance)


def test_the_same_seed_gives_the_same_readings_and_only_sensors_that_fire_read():
    def run(seed):
        heard = HeardWalls(AHEAD, GaussianModel(0.1, miss=0.3), KIWI, SensorSettings(seed=seed))
        return [[e.distance for e in heard.ping(ORIGIN, ALL, 0.1 * k)] for k in range(1, 40)]

    assert run(1) == run(1) != run(2)
    assert {len(echoes) for echoes in run(1)} == {0, 1}  # silence leaves nothing
    none = HeardWalls(AHEAD, "ideal", KIWI, SensorSettings()).ping(ORIGIN, ~ALL, 1.0)
    assert none == []


def test_a_session_gets_readings_sampled_at_the_ping(pair):
    service = SonarService(pair[0], HeardWalls(AHEAD, "srf08-mlp", KIWI, FAST), np.zeros(len(KIWI)))
    worker = threading.Thread(target=service.run, args=(0.7,))
    worker.start()
    found = []
    while worker.is_alive():
        envelope = pair[1].receive(0.05)
        found += [] if envelope is None else [envelope]
    assert {(e.message, e.sender_stamp) for e in found} == {(READING, 0)}
    assert 8 <= len(found) <= service.published <= 14
    delay = [seconds_of(e.sent) - seconds_of(e.sampled) for e in found]
    assert 0.0 < np.median(delay) < 2.0 * FAST.latency_s  # a busy machine may be late
    sampled = [seconds_of(e.sampled) for e in found]
    assert (sampled[-1] - sampled[0]) / 0.05 == pytest.approx(len(found) - 1, abs=1.5)
    assert all(abs(e.fields["distance"] * 100 - round(e.fields["distance"] * 100)) < 1e-4 for e in found)


def test_frames_are_followed_and_a_flood_of_noise_does_not_stop_the_sonars(pair):
    service = SonarService(pair[0], HeardWalls(AHEAD, "ideal", KIWI, FAST), np.zeros(len(KIWI)))
    worker = threading.Thread(target=service.run, args=(0.8,))
    worker.start()
    pair[1].send(FRAME, {"x": 1.0}, sender_stamp=0)
    pair[1].send(FRAME, {"x": -9.0}, sender_stamp=5)  # another car
    found = []
    while worker.is_alive():
        for _ in range(20):
            pair[1].link.send(b"noise")
        envelope = pair[1].receive(0.005)
        found += [] if envelope is None else [envelope.fields["distance"]]
    assert found[-1] == pytest.approx(1.0 - KIWI[0].x, abs=1e-6)
    assert service.published >= 8


def test_a_frame_that_is_not_finite_is_ignored():
    now = (0, 0)
    frame = Envelope(FRAME, {"x": np.nan, "y": 0.0, "yaw": 0.0}, 0, now, now, now)
    assert updated_pose((1.0, 2.0, 3.0), frame, 0) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"frequency_hz": 0.0}, "frequency_hz must lie in"),
        ({"latency_s": 0.2}, "more than the 0.1 s between two pings"),
        ({"max_range": np.nan}, "max_range: expected a finite number, got nan"),
    ],
)
def test_settings_outside_their_limits_are_named(settings, text):
    with pytest.raises(SettingError, match=text):
        SensorSettings(**settings)


def test_a_map_is_its_walls(tmp_path):
    path = tmp_path / "room.map"
    path.write_text("0,1.5,2.25,-3;\n2,-1,2,1;\n\n")
    assert load_map(path).segments.tolist() == [[0.0, 1.5, 2.25, -3.0], [2.0, -1.0, 2.0, 1.0]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3;\n", "line 1: '1,2,3;', expected x1,y1,x2,y2; in m"),
        ("0,0,1,1;\n0,0,nan,1;\n", "line 2: .* expected finite numbers"),
        ("", "has 0 walls"),
    ],
)
def test_a_line_that_is_no_wall_is_named(tmp_path, text, message):
    path = tmp_path / "room.map"
    path.write_text(text)
    with pytest.raises(RecordingError, match=message):
        load_map(path)


def test_a_missing_map_is_named(tmp_path):
    with pytest.raises(RecordingNotFoundError, match="no such map"):
        load_map(tmp_path / "room.map")


def test_readings_do_not_fall_behind_their_schedule(pair, retry):
    def attempt():
        service = SonarService(pair[0], HeardWalls(AHEAD, "srf08-mlp", KIWI * 2, FAST), np.zeros(2 * len(KIWI)))
        service.run(2.0, record_lateness=True)
        late = np.array(service.lateness)
        assert np.median(late[len(late) // 2 :]) < 0.5 / FAST.frequency_hz  # no backlog; benchmarks measure the jitter

    retry(attempt)
