"""Recordings as ROS 2 bags, MCAP or SQLite, by rosbags; `acquisition.io.logs.bags` reads them back.

The readings of a sensor are on `/sonar/NAME`, the true distances on `/sonar/NAME/true`, and the credence, if a model is
given, on `/sonar/NAME/credence`; see `messages`.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from acquisition import Recording, RecordingError, SettingError
from acquisition.arguments import checked
from acquisition.extras import require
from acquisition.limits import PositiveMetres
from noise import CredenceTable
from sonar_gym.bridges.ros.messages import (
    CREDENCE_TOPIC,
    DIAGNOSTIC_TYPE,
    MIN_RANGE,
    RANGE_TYPE,
    ULTRASOUND,
    diagnostics,
    range_values,
)
from sonar_gym.sensing.mounts import CONE_DEG
from sonar_gym.sensing.sonar import SonarChoice, broad_table, resolve

ROOT = "/sonar"
TRUE_TOPIC = "true"
MAX_STAMP = 2.0**31  # s since 1970; of builtin_interfaces/Time
BAG_VERSION: Literal[9] = 9


@dataclass(frozen=True)
class _Bag:
    """An open bag and the types of its messages."""

    writer: Any
    store: Any
    connections: dict[str, Any]

    def write(self, topic: str, kind: str, message: Any, stamp_ns: int) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        self.writer.write(self.connections[topic], stamp_ns, self.store.serialize_cdr(message, kind))

    def header(self, stamp_ns: int, frame: str) -> Any:
        types = self.store.types
        time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


@checked
def write_bag(
    recording: Recording,
    folder: Path,
    model: SonarChoice | None = None,
    max_range: PositiveMetres = 6.0,
    sqlite: bool = False,
    start_s: float = 1_600_000_000.0,
) -> int:
    """Write the readings of a recording and return their number.

    Args:
        recording: the recording.
        folder: of the new bag.
        model: sonar model by which the credence of the readings is computed; None for no credence.
        max_range: of the messages, m.
        sqlite: SQLite in place of MCAP.
        start_s: time of `time_s` = 0, s since 1970; a recording does not state it.

    Raises:
        SettingError: the folder exists.
        MissingExtraError: rosbags is not installed.
    """
    if folder.exists():
        raise SettingError(f"{folder}: exists; give the name of a new folder")
    require("rosbags", "ros")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    table = None if model is None else broad_table(resolve(model), max_range)
    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}") as beside:
        fresh = Path(beside) / folder.name
        with Writer(fresh, version=BAG_VERSION, storage_plugin=plugin) as writer:
            _write(_Bag(writer, get_typestore(Stores.ROS2_HUMBLE), {}), recording, table, max_range, start_s)
        os.replace(fresh, folder)
    return len(recording)


def _write(bag: _Bag, recording: Recording, table: CredenceTable | None, max_range: float, start_s: float) -> None:
    ping, reading = recording.ping, recording.reading
    if not 0.0 <= start_s + float(ping.time.min()) <= start_s + float(ping.time.max()) < MAX_STAMP:
        span = f"{ping.time.min():g} to {ping.time.max():g} s"
        raise RecordingError(
            f"{recording.name}: time_s runs from {span}; a bag that begins at {start_s:g} s holds 0 to {MAX_STAMP:g} s"
        )
    names = recording.table["sensor"].astype(str).to_numpy() if recording.has("sensor") else np.full(len(ping), "0")
    topics = _topics(recording.name, names)
    credence = np.zeros(len(ping)) if table is None else table.given(reading)
    values, states = range_values(reading, MIN_RANGE), diagnostics(reading, credence)
    for k in np.argsort(ping.time, kind="stable"):
        stamp, topic = round((start_s + float(ping.time[k])) * 1e9), topics[names[k]]
        bag.write(topic, RANGE_TYPE, _range(bag, stamp, names[k], float(values[k]), max_range), stamp)
        true = _range(bag, stamp, names[k], float(ping.distance[k]), np.inf)
        bag.write(f"{topic}/{TRUE_TOPIC}", RANGE_TYPE, true, stamp)
        if table is not None:
            bag.write(f"{topic}/{CREDENCE_TOPIC}", DIAGNOSTIC_TYPE, _array(bag, stamp, names[k], states[k]), stamp)


def _topics(recording: str, names: Iterable[str]) -> dict[str, str]:
    """Return the topic of each sensor of a recording."""
    owner: dict[str, str] = {}
    for name in dict.fromkeys(names):
        topic = _topic(name)
        if topic in owner:
            raise RecordingError(
                f"{recording}: sensors {owner[topic]!r} and {name!r} would both be on {topic}: rename one of them"
            )
        owner[topic] = name
    return {name: topic for topic, name in owner.items()}


def _topic(name: str) -> str:
    """Return the topic of a sensor; a part of it has letters, digits and underscores, and does not begin with a digit.

    >>> _topic("front left"), _topic("0")
    ('/sonar/front_left', '/sonar/sensor_0')
    """
    part = re.sub(r"\W", "_", name, flags=re.ASCII) or "_"
    return f"{ROOT}/sensor_{part}" if part[0].isdigit() else f"{ROOT}/{part}"


def _range(bag: _Bag, stamp_ns: int, frame: str, value: float, max_range: float) -> Any:
    return bag.store.types[RANGE_TYPE](
        header=bag.header(stamp_ns, frame),
        radiation_type=ULTRASOUND,
        field_of_view=float(np.radians(CONE_DEG)),
        min_range=MIN_RANGE if np.isfinite(max_range) else 0.0,
        max_range=max_range,
        range=value,
    )


def _array(bag: _Bag, stamp_ns: int, frame: str, state: tuple[int, str, dict[str, str]]) -> Any:
    types, (level, text, values) = bag.store.types, state
    pairs = [types["diagnostic_msgs/msg/KeyValue"](key=key, value=value) for key, value in values.items()]
    status = types["diagnostic_msgs/msg/DiagnosticStatus"](
        level=level, name=frame, message=text, hardware_id="sonar", values=pairs
    )
    return types[DIAGNOSTIC_TYPE](header=bag.header(stamp_ns, frame), status=[status])
