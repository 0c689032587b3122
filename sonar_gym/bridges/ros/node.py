"""A ROS 2 node: subscribes ideal ranges of a simulator and publishes what sonars would read there.

For a topic `/front` of `sensor_msgs/Range` it publishes `/front/heard` and `/front/heard/credence`; for a LaserScan,
`/scan/heard` of all sectors, with frame ids `FRAME_sector_K`. Quality of service: sensor data. See `messages` for
silence and credence. It needs rclpy, which comes with ROS 2 and not from PyPI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquisition import MissingExtraError, SettingError
from acquisition.arrays import Floats
from sonar_gym.bridges.ros.hearing import HeardRanges, scan_sectors
from sonar_gym.bridges.ros.messages import (
    CREDENCE_TOPIC,
    MIN_RANGE,
    ULTRASOUND,
    diagnostics,
    ideal_distances,
    range_values,
)
from sonar_gym.sensing.sonar import SonarChoice

SCAN_SUFFIX = ":LaserScan"
HEARD = "heard"
NODE_NAME = "sonar_gym"


@dataclass(frozen=True)
class NodeSettings:
    """Default values of the node's parameters, which have the same names.

    Attributes:
        model: name or path of the sonar model.
        max_range: maximum range, m.
        reflectance: of what is seen, 0..1.
        sectors: sectors of a LaserScan, each one sonar.
        seed: of the readings.
    """

    model: SonarChoice = "srf08-mlp"
    max_range: float = 6.0
    reflectance: float = 0.5
    sectors: int = 8
    seed: int = 0


@dataclass(frozen=True)
class Types:
    """Classes of the messages; tests pass their own."""

    range: Any
    scan: Any
    array: Any
    status: Any
    pair: Any


class HeardNode:
    """The node's work on an `rclpy` node, or an object with its methods.

    Args:
        node: provides `declare_parameter`, `create_publisher` and `create_subscription`.
        topics: topics to subscribe; those that end with `:LaserScan` are scans.
        settings: default values of the parameters.
        types: classes of the messages.
        qos: quality of service.
    """

    def __init__(self, node: Any, topics: Sequence[str], settings: NodeSettings, types: Types, qos: Any) -> None:
        if not topics:
            raise SettingError("ros-node: expected one topic or more of ideal ranges")
        self.types, names = types, ("max_range", "reflectance", "sectors", "seed")
        value = {name: node.declare_parameter(name, getattr(settings, name)).value for name in names}
        model = node.declare_parameter("model", str(settings.model)).value
        self.max_range, self.sectors = float(value["max_range"]), int(value["sectors"])
        self.heard = HeardRanges(model, self.max_range, float(value["reflectance"]), int(value["seed"]))
        for given in topics:
            topic, is_scan = given.removesuffix(SCAN_SUFFIX), given.endswith(SCAN_SUFFIX)
            out = (
                node.create_publisher(types.range, f"{topic}/{HEARD}", qos),
                node.create_publisher(types.array, f"{topic}/{HEARD}/{CREDENCE_TOPIC}", qos),
            )
            take = self._scan if is_scan else self._range
            kind = types.scan if is_scan else types.range
            node.create_subscription(kind, topic, lambda message, take=take, out=out: take(message, out), qos)

    def _range(self, message: Any, out: tuple[Any, Any]) -> None:
        given = np.array([float(message.range)])
        distance = ideal_distances(given, float(message.min_range), float(message.max_range))
        self._publish(message.header, [message.header.frame_id], distance, np.zeros(1), message.field_of_view, out)

    def _scan(self, message: Any, out: tuple[Any, Any]) -> None:
        ranges = np.asarray(message.ranges, dtype=np.float64)
        angles = float(message.angle_min), float(message.angle_increment)
        distance, bearing = scan_sectors(
            ranges, *angles, float(message.range_max), self.sectors, float(message.range_min)
        )
        frames = [f"{message.header.frame_id}_sector_{k}" for k in range(self.sectors)]
        view = abs(float(message.angle_increment)) * len(ranges) / self.sectors
        self._publish(message.header, frames, distance, bearing, view, out)

    def _publish(
        self, header: Any, frames: list[str], distance: Floats, bearing: Floats, view: float, out: tuple[Any, Any]
    ) -> None:
        now = header.stamp.sec + 1e-9 * header.stamp.nanosec
        names, reading, credence = self.heard.hear(frames, distance, bearing, now)
        if not names:
            return
        array = self.types.array()
        array.header = header
        values = range_values(reading, MIN_RANGE)
        for name, value, state in zip(names, values, diagnostics(reading, credence), strict=True):
            out[0].publish(self._message(header, name, float(value), view))
            array.status.append(self._status(name, *state))
        out[1].publish(array)

    def _message(self, header: Any, frame: str, value: float, view: float) -> Any:
        message = self.types.range()
        message.header.stamp, message.header.frame_id = header.stamp, frame
        message.radiation_type, message.field_of_view = ULTRASOUND, float(view)
        message.min_range, message.max_range, message.range = MIN_RANGE, self.max_range, value
        return message

    def _status(self, name: str, level: int, text: str, values: dict[str, str]) -> Any:
        status = self.types.status()
        status.level, status.name, status.message = bytes([level]), name, text  # rclpy has bytes for a byte
        for key, value in values.items():
            pair = self.types.pair()
            pair.key, pair.value = key, value
            status.values.append(pair)
        return status


def run_node(topics: Sequence[str], settings: NodeSettings) -> None:
    """Run the node until it is shut down.

    Raises:
        MissingExtraError: rclpy is not installed.
    """
    try:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import LaserScan, Range
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f"ros-node needs {error.name!r} of ROS 2: `source /opt/ros/DISTRO/setup.bash`, with a shared Python"
        ) from None
    rclpy.init()
    node = rclpy.create_node(NODE_NAME)
    try:
        types = Types(Range, LaserScan, DiagnosticArray, DiagnosticStatus, KeyValue)
        HeardNode(node, topics, settings, types, qos_profile_sensor_data)
        rclpy.spin(node)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
