"""This project's sonar on a car of an OpenDLV session: one process for all sensors of the car.

It listens to the car's Frame, hears the walls of a map with any law, and publishes DistanceReading as the device driver
of the SRF08 does: the first echo in whole centimetres, and nothing where there is no echo. Unlike the driver's, the
sample time is the time of the ping.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition import EchoStatus, SettingError
from acquisition.arrays import Bits, Floats
from acquisition.limits import check_settings
from sonar_gym.bridges.opendlv.messages import FRAME, READING
from sonar_gym.bridges.opendlv.session import Session
from sonar_gym.bridges.opendlv.walls import ORIGIN, Pose
from sonar_gym.bridges.opendlv.wire import Envelope
from sonar_gym.sensing import records
from sonar_gym.sensing.crosstalk import Surroundings, add_crosstalk
from sonar_gym.sensing.detection import detection_table, has_beam, listening_table
from sonar_gym.sensing.mounts import Mount, in_world, mount_arrays
from sonar_gym.sensing.paths import cast_paths
from sonar_gym.sensing.pipeline import Sensing
from sonar_gym.sensing.scene import Scene
from sonar_gym.sensing.sonar import Sonar, SonarChoice, resolve

TAG = 0x0D14  # of the random stream
ROW = np.zeros(1, np.int64)  # row of the single car
KIWI = (  # senderStamp 0 front, 1 left, 2 rear, 3 right; front and rear are SRF08 on the miniature car
    Mount("front", 0.36, 0.0, 0.0),
    Mount("left", 0.13, 0.10, 90.0),
    Mount("rear", -0.09, 0.0, 180.0),
    Mount("right", 0.13, -0.10, -90.0),
)


@dataclass(frozen=True)
class SensorSettings:
    """How the sensors work.

    Attributes:
        frame_id: senderStamp of the car's Frame.
        frequency_hz: pings of each sensor per second.
        latency_s: time from a ping to its publication, s; the device driver waits 0.07 s.
        max_range: greatest range, m; 6 m is that of OpenDLV's own simulated sensor.
        step_m: step of the published distances, m; the driver publishes centimetres. 0: as the law.
        crosstalk: whether sensors that fire together receive each other's bursts.
        seed: of the random numbers.
    """

    frame_id: int = 0
    frequency_hz: float = 10.0
    latency_s: float = 0.07
    max_range: float = 6.0
    step_m: float = 0.01
    crosstalk: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise SettingError for values outside their limits."""
        check_settings(self)
        limits = {"frequency_hz": 1000.0, "max_range": 20.0, "latency_s": 1.0, "step_m": 1.0}
        for name, limit in limits.items():
            low = 0.0 if name in ("latency_s", "step_m") else 1e-3
            if not low <= getattr(self, name) <= limit:
                raise SettingError(
                    f"SensorSettings.{name} must lie in [{low:g}, {limit:g}], got {getattr(self, name):g}"
                )
        if self.latency_s * self.frequency_hz > 1.0 + 1e-9:
            raise SettingError(
                f"SensorSettings.latency_s is {self.latency_s:g} s, more than the {1 / self.frequency_hz:g} s between "
                "two pings: lower frequency_hz or latency_s"
            )


@dataclass(frozen=True)
class Echo:
    """An echo to be published.

    Attributes:
        sensor: number of the sensor.
        distance: as published, m.
        ping_s: time of the ping, s.
    """

    sensor: int
    distance: float
    ping_s: float


class HeardWalls:
    """The sonars of one car among walls.

    Args:
        scene: the walls.
        model: name, path or model of the sonars.
        mounts: the sonars; each has the senderStamp of its place.
        settings: how they work.
    """

    def __init__(self, scene: Scene, model: SonarChoice, mounts: Sequence[Mount], settings: SensorSettings) -> None:
        if not 1 <= len(mounts) <= 256:
            raise SettingError(f"sensors: expected 1 to 256 mounts, got {len(mounts)}")
        self.scene, self.settings = scene, settings
        resolved, count, period = resolve(model), len(mounts), 1.0 / settings.frequency_hz
        self._poses, self._half = mount_arrays(mounts)
        self._table = detection_table(resolved, settings.max_range)
        self._crosstalk = settings.crosstalk and has_beam(self._table)
        self._listening = listening_table(resolved) if self._crosstalk else self._table
        self._sensing = Sensing(
            Sonar(resolved, count, settings.max_range, TAG), np.tile([period, 0.0, 0.0], (count, 1)), period
        )
        self._sensing.sonar.seed(settings.seed)
        self._sensing.begin(ROW)

    def ping(self, pose: Pose, which: Bits, now: float) -> list[Echo]:
        """Return the echoes of pings sent now, sensor by sensor.

        Args:
            pose: of the car.
            which: mask of the sensors that fire, (s,).
            now: time, s, greater than 0 and increasing.
        """
        p, faces = self._sensing.pings, (self.scene.segments, self.scene.surface, self.scene.owner)
        poses = in_world(self._poses, np.array(pose, dtype=np.float64))
        for i in np.flatnonzero(which):
            x, y, heading = poses[i]
            p.n_paths[0, i] = cast_paths(
                x, y, heading, self._half[i], *faces, self.settings.max_range, self._table, p.paths[0, i]
            )
        p.fired[0], p.sent[0, which] = which, now
        if self._crosstalk:
            around = Surroundings(*faces, self.settings.max_range, self._table, self._listening)
            add_crosstalk(poses, which, p.sent[0], p.before[0], around, p.paths[0], p.n_paths[0])
        self._sensing.update(ROW, np.array([now]))
        shown = p.of_shown(0)[:, [records.RANGE, records.STATUS]].T
        heard = [i for i in np.flatnonzero(which) if shown[1, i] == EchoStatus.ECHO]
        found = [Echo(int(i), self._published(shown[0, i]), now) for i in heard]
        return [echo for echo in found if echo.distance > 0.0]  # a register of 0 means no echo

    def _published(self, range_m: float) -> float:
        step = self.settings.step_m
        return float(round(range_m / step) * step if step else range_m)


class SonarService:
    """Publishes the readings of a car's sonars in a session, in real time.

    Args:
        session: the session.
        heard: the sonars.
        phases: time of the first ping of each sonar, s, (s,).
    """

    def __init__(self, session: Session, heard: HeardWalls, phases: Floats) -> None:
        self.session, self.heard, self.phases = session, heard, phases
        self.pose: Pose = ORIGIN
        self.published = 0
        self.lateness: list[float] = []  # of the publications, s

    def run(self, duration_s: float = np.inf, record_lateness: bool = False) -> None:
        """Publish until a time has passed, s.

        Args:
            duration_s: time to run, s.
            record_lateness: keep the delay of each publication behind its schedule in `lateness`.
        """
        settings = self.heard.settings
        period, start = 1.0 / settings.frequency_hz, time.monotonic() + 0.01
        epoch = self.session.clock() - time.monotonic()  # of the monotonic clock, s since 1970
        due = np.maximum(self.phases, 0.0) + start
        waiting: list[tuple[float, int, Echo]] = []
        while (now := time.monotonic()) < start + duration_s:
            while waiting and waiting[0][0] <= now:
                at, _, echo = heapq.heappop(waiting)
                self._publish(echo, epoch)
                if record_lateness:
                    self.lateness.append(time.monotonic() - at)
            fires = due <= now
            if fires.any():
                for echo in self.heard.ping(self.pose, fires, now):
                    at = due[echo.sensor] + settings.latency_s
                    heapq.heappush(waiting, (at, echo.sensor, echo))
                missed = np.floor((now - due[fires]) / period)  # pings that a busy machine has not sent in time
                due[fires] += (missed + 1.0) * period
            following = min(float(due.min()), waiting[0][0] if waiting else np.inf, start + duration_s)
            self._listen(following)

    def _listen(self, until: float) -> None:
        """Read the messages of the session until a time, s; a flood of them does not hold up the sonars."""
        while (left := until - time.monotonic()) > 0.0:
            envelope = self.session.receive(left)
            if envelope is not None:
                self.pose = updated_pose(self.pose, envelope, self.heard.settings.frame_id)

    def _publish(self, echo: Echo, epoch: float) -> None:
        self.session.send(READING, {"distance": echo.distance}, echo.sensor, sampled=epoch + echo.ping_s)
        self.published += 1


def updated_pose(pose: Pose, envelope: Envelope, frame_id: int) -> Pose:
    """Return the pose in a Frame with an id; of any other message, or one that is not finite, the pose before."""
    if envelope.message != FRAME or envelope.sender_stamp != frame_id:
        return pose
    found = envelope.fields["x"], envelope.fields["y"], envelope.fields["yaw"]
    return found if np.all(np.isfinite(found)) else pose
