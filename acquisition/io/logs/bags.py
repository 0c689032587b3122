"""Import of ROS bags (ROS 1 .bag, ROS 2 folders, .db3, .mcap) with `sensor_msgs/Range`. Requires rosbags.

The meaning of `range` follows REP 117 and the definition of the message:

| range | reading |
|---|---|
| from `min_range` to below `max_range` | the range |
| +Inf, `max_range` or more, and 0 | no echo |
| -Inf, below `min_range` (too close to measure), negative | no answer: an object at an unknown distance |
| NaN | no answer |

A bag does not contain the true distance. It comes from constants, from another topic, or from a table over time; pings
without a true distance close in time are omitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from acquisition.arguments import checked
from acquisition.arrays import Bits, Floats
from acquisition.errors import RecordingError, RecordingNotFoundError, SettingError
from acquisition.extras import require
from acquisition.io.columns import DIGITS
from acquisition.io.logs.foreign import check_once
from acquisition.io.memory import memory_limited
from acquisition.io.recording import Recording
from acquisition.io.tables import read_text_table

SUFFIXES = (".bag", ".mcap", ".db3")
RANGE_TYPE = "sensor_msgs/msg/Range"
INFRARED = 1  # radiation_type of sensor_msgs/Range
NO_ECHO_MM, NO_ANSWER_MM = 0.0, np.nan
# message type -> its position
POSITIONS: Mapping[str, Callable[[Any], Any]] = {
    "geometry_msgs/msg/PointStamped": lambda message: message.point,
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose.position,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose.position,
    "geometry_msgs/msg/TransformStamped": lambda message: message.transform.translation,
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose.position,
}
# column of a table of true values -> column of the recording, factor
TRUTH_COLUMNS: Mapping[str, tuple[str, float]] = {
    "distance_m": ("distance_mm", 1000.0),
    "distance_cm": ("distance_mm", 10.0),
    "distance_mm": ("distance_mm", 1.0),
    "angle_deg": ("angle_deg", 1.0),
    "incidence_deg": ("incidence_deg", 1.0),
    "reflectance": ("reflectance", 1.0),
}
TIME_COLUMNS = ("time_s", "stamp_s")
MAX_MEMORY, MEMORY_PER_BYTE = 2**30, 20  # bytes, at least and for each of the file; more is meant to fill the memory
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class GroundTruthSource:
    """Source of the true distance of each ping: a topic or a table.

    Attributes:
        topic: topic of a second range finder (`sensor_msgs/Range`) or of a position.
        point: position of the reflector, m, in the frame of the topic's positions.
        table: CSV file with `time_s` (since the first ping) or `stamp_s` (the bag's clock) and any of `TRUTH_COLUMNS`.
        longest_gap_s: longest gap between two true values that is interpolated, s.
    """

    topic: str = ""
    point: tuple[float, float, float] | None = None
    table: Path | None = None
    longest_gap_s: float = 0.5

    def __post_init__(self) -> None:
        """Raise SettingError for two sources or an invalid gap."""
        if self.topic and self.table:
            raise SettingError("truth: expected a topic or a table, got both")
        if not self.longest_gap_s > 0.0:
            raise SettingError(f"longest gap: expected more than 0 s, got {self.longest_gap_s:g} s")


@dataclass(frozen=True)
class ImportedBag:
    """Result of an import.

    Attributes:
        recording: pings of all selected topics, in chronological order.
        left_out: number of pings without a true distance.
        too_close: number of pings that are too close to measure according to REP 117.
    """

    recording: Recording
    left_out: int
    too_close: int


@dataclass(frozen=True)
class TimeSeries:
    """Values over time: ascending time stamps, s, (n,), and columns, each (n,)."""

    stamp: Floats
    columns: Mapping[str, Floats] = field(default_factory=dict)

    def interpolate(self, stamp: Floats, longest_gap_s: float) -> dict[str, Floats]:
        """Interpolate each column linearly; NaN outside the time span and inside gaps that are too long."""
        after = np.searchsorted(self.stamp, stamp).clip(1, max(len(self.stamp) - 1, 1))
        inside = (stamp >= self.stamp[0]) & (stamp <= self.stamp[-1])
        if len(self.stamp) > 1:
            near = np.minimum(stamp - self.stamp[after - 1], self.stamp[after] - stamp) <= 1e-9
            inside &= near | (self.stamp[after] - self.stamp[after - 1] <= longest_gap_s)
        return {k: np.where(inside, np.interp(stamp, self.stamp, v), np.nan) for k, v in self.columns.items()}


def is_bag(path: Path) -> bool:
    """Return whether a path has the name of a bag file or is the folder of a ROS 2 bag."""
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").is_file()


def size_of(path: Path) -> int:
    """Return the number of bytes of a file, or of the files in a folder; 0 for neither."""
    files = [each for each in (path, *path.glob("*")) if each.is_file()]
    return sum(each.stat().st_size for each in files)


@checked
def import_bag(
    path: Path,
    topics: Sequence[str] = (),
    truth: GroundTruthSource | None = None,
    constants: Mapping[str, float | str] | None = None,
    progress: Progress | None = None,
) -> ImportedBag:
    """Read the sonars of a bag as a recording; the name of a sensor is its frame.

    Args:
        path: of the bag.
        topics: topics of `sensor_msgs/Range`; by default all except infrared sensors.
        truth: source of the true distance, unless `constants` has `distance_mm`.
        constants: columns with one value in all rows; `angle_deg` is 0 by default.
        progress: called with the number of messages read and the total.

    Raises:
        RecordingNotFoundError: the file does not exist.
        RecordingError: the bag is unreadable, a topic is missing, or no ping has a true distance.
        SettingError: the true distance has no source, or a column has two.
        MissingExtraError: rosbags is not installed.
    """
    truth, constants = truth or GroundTruthSource(), dict(constants or {})
    if not (truth.topic or truth.table or "distance_mm" in constants):
        raise SettingError(f"{path}: a bag has no true distance; give a constant distance_mm, a topic or a table")
    with memory_limited(max(MAX_MEMORY, MEMORY_PER_BYTE * size_of(path))), _Bag(path) as bag:
        chosen = bag.sonars(topics, truth.topic)
        pings = pd.concat([bag.pings(topic, progress) for topic in chosen], ignore_index=True)
        known = bag.true_distances(truth) if truth.topic else None
    if pings.empty:
        raise RecordingError(f"{path}: topic {', '.join(chosen)}: has no message")
    pings = pings.sort_values("stamp_s", kind="stable", ignore_index=True)
    first = float(pings["stamp_s"].iloc[0])
    if truth.table:
        known = read_table(truth.table, first)
    stamp = pings["stamp_s"].to_numpy()
    given = {} if known is None else known.interpolate(stamp, truth.longest_gap_s)
    valid = np.all([np.isfinite(column) for column in given.values()] or [np.ones(len(pings), bool)], axis=0)
    check_once([*given, *constants])
    columns = {"time_s": stamp - first, "session": path.name, "angle_deg": 0.0, **given, **constants}
    table = pings.assign(**columns)
    table, too_close = table[valid], int(pings["too_close"].sum())
    if table.empty:
        raise RecordingError(
            f"{path}: no ping lies within {truth.longest_gap_s:g} s of a true distance; "
            "check that both use the same clock"
        )
    return ImportedBag(_recording(table, path), int((~valid).sum()), too_close)


def _recording(table: pd.DataFrame, path: Path) -> Recording:
    table = table.drop(columns=["stamp_s", "too_close"]).reset_index(drop=True)
    number = table.select_dtypes("number")
    table[number.columns] = number.round(6)
    text = table.astype(object).where(table.notna(), "").map(_text)
    return Recording.from_text(text, str(path))


def _text(value: Any) -> str:
    return f"{value:{DIGITS}}" if isinstance(value, float) else str(value)


def read_table(path: Path, first_stamp: float) -> TimeSeries:
    """Read a table of true values over time; `time_s` counts from `first_stamp`.

    Raises:
        RecordingNotFoundError: the file does not exist.
        RecordingError: a column is missing, a value is not a number, or time does not increase.
    """
    table = read_text_table(path)
    time = next((name for name in TIME_COLUMNS if name in table), None)
    known = [name for name in TRUTH_COLUMNS if name in table]
    if time is None or not known:
        raise RecordingError(
            f"{path}, line 1: expected {' or '.join(TIME_COLUMNS)} and one or more of {', '.join(TRUTH_COLUMNS)}, "
            f"found {', '.join(map(str, table.columns))}"
        )
    number = table[[time, *known]].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    faulty = np.argwhere(~np.isfinite(number))
    if not len(number) or len(faulty):
        line, column = (2, 0) if not len(number) else (table.index[faulty[0, 0]] + 2, int(faulty[0, 1]))
        raise RecordingError(f"{path}, line {line}, column {[time, *known][column]}: expected a number")
    back = np.flatnonzero(np.diff(number[:, 0]) <= 0)
    if len(back):
        line = table.index[back[0] + 1] + 2
        raise RecordingError(f"{path}, line {line}, column {time}: expected a larger value than in the previous line")
    stamp = number[:, 0] + (first_stamp if time == "time_s" else 0.0)
    return TimeSeries(stamp, {TRUTH_COLUMNS[n][0]: number[:, k] * TRUTH_COLUMNS[n][1] for k, n in enumerate(known, 1)})


def reading_mm(range_m: Floats, min_range_m: Floats, max_range_m: Floats) -> tuple[Floats, Bits]:
    """Return readings as in a recording, mm (0: no echo, NaN: no answer), and the mask of those too close to measure.

    >>> reading_mm(np.array([1.0, np.inf, -np.inf, np.nan]), np.full(4, 0.02), np.full(4, 4.0))[0]
    array([1000.,    0.,   nan,   nan])
    """
    no_echo = (range_m == 0.0) | ((max_range_m > 0.0) & (range_m >= max_range_m)) | np.isposinf(range_m)
    too_close = ~no_echo & (range_m < np.maximum(min_range_m, 0.0))
    reading = np.where(no_echo, NO_ECHO_MM, np.where(too_close, NO_ANSWER_MM, range_m * 1000.0))
    return reading, too_close


class _Bag:
    """An open bag; any failure of the reader becomes a RecordingError."""

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise RecordingNotFoundError(f"{path}: no such bag; give a .bag, .mcap or .db3 file, or a ROS 2 folder")
        require("rosbags", "ros")
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self.path = path
        # bags written before ROS 2 Iron contain no message definitions; those of Humble apply
        self._open = lambda: AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))

    def __enter__(self) -> _Bag:
        self._reader = self._read(lambda: self._open().__enter__())
        return self

    def __exit__(self, *error: object) -> None:
        self._reader.close()

    def _read(self, work: Callable[[], Any]) -> Any:
        """Run an operation on the file. A corrupt one raises almost any exception; its messages may lack any field."""
        try:
            return work()
        except RecordingError:
            raise
        except MemoryError as error:  # a damaged length can be anything, and a small chunk can claim to expand to it
            raise RecordingError(
                f"{self.path}: not a readable bag: it takes more than {MAX_MEMORY // 2**20} MiB of memory "
                f"and {MEMORY_PER_BYTE} times its size"
            ) from error
        except Exception as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise RecordingError(f"{self.path}: not a readable bag: {reason}") from error

    def _topics(self) -> dict[str, str]:
        return {name: str(info.msgtype) for name, info in self._reader.topics.items()}

    def sonars(self, requested: Sequence[str], truth: str) -> list[str]:
        """Return the topics to import."""
        available = [name for name, kind in self._topics().items() if kind == RANGE_TYPE]
        for name in requested:
            self._expect(name, available)
        if not available:
            raise RecordingError(f"{self.path}: has no topic of sensor_msgs/Range; found {self._topic_list()}")
        chosen = list(requested) or [name for name in available if name != truth and not self._is_infrared(name)]
        if not chosen:
            raise RecordingError(f"{self.path}: {', '.join(available)}: infrared or the true distance; select a topic")
        return chosen

    def _expect(self, name: str, available: Sequence[str]) -> None:
        if name not in available:
            raise RecordingError(
                f"{self.path}: topic {name!r} is not one of {', '.join(available) or self._topic_list()}"
            )

    def _topic_list(self) -> str:
        return ", ".join(f"{name} ({kind})" for name, kind in self._topics().items()) or "no topics"

    def _is_infrared(self, topic: str) -> bool:
        kinds = (message.radiation_type for _, message in self._messages(topic))
        return self._read(lambda: next(kinds, None) == INFRARED)

    def _messages(self, topic: str, progress: Progress | None = None) -> Iterator[tuple[float, Any]]:
        """Yield time stamp, s, and message; an empty stamp in the header is replaced by the time of receipt."""
        info = self._reader.topics[topic]
        connections = [c for c in self._reader.connections if c.topic == topic]
        for number, (connection, received, raw) in enumerate(self._reader.messages(connections), 1):
            message = self._reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            yield (stamp if stamp > 0.0 else received * 1e-9), message
            if progress is not None and (number % 500 == 0 or number == info.msgcount):
                progress(number, info.msgcount)

    def pings(self, topic: str, progress: Progress | None) -> pd.DataFrame:
        """Return a table with one row per message of a sonar."""
        rows = self._read(lambda: [(stamp, *_range_fields(m)) for stamp, m in self._messages(topic, progress)])
        names = ["stamp_s", "sensor", "range", "min_range", "max_range", "view"]
        table = pd.DataFrame(rows, columns=names)
        reading, too_close = reading_mm(
            *(table[name].to_numpy(np.float64) for name in ("range", "min_range", "max_range"))
        )
        return pd.DataFrame(
            {
                "stamp_s": table["stamp_s"].astype(np.float64),
                "sensor": table["sensor"].replace("", topic),
                "reading_mm": reading,
                "field_of_view_deg": np.rad2deg(table["view"].to_numpy(np.float64)),
                "min_range_mm": table["min_range"].to_numpy(np.float64) * 1000.0,
                "max_range_mm": table["max_range"].to_numpy(np.float64) * 1000.0,
                "too_close": too_close,
            }
        )

    def true_distances(self, truth: GroundTruthSource) -> TimeSeries:
        """Return the distances over time of a topic, mm."""
        kinds = self._topics()
        self._expect(truth.topic, [name for name, kind in kinds.items() if kind == RANGE_TYPE or kind in POSITIONS])
        kind = kinds[truth.topic]
        if kind != RANGE_TYPE and truth.point is None:
            raise SettingError(f"{truth.topic}: is a position; give the point of the reflector")
        rows = self._read(lambda: [(s, _distance_mm(m, kind, truth.point)) for s, m in self._messages(truth.topic)])
        known = np.array(rows, dtype=np.float64).reshape(-1, 2)
        known = known[np.isfinite(known).all(axis=1)]
        known = known[np.unique(known[:, 0], return_index=True)[1]]
        if not len(known):
            raise RecordingError(f"{self.path}: topic {truth.topic}: has no distance")
        return TimeSeries(known[:, 0], {"distance_mm": known[:, 1]})


def _range_fields(message: Any) -> tuple[str, float, float, float, float]:
    span = float(message.min_range), float(message.max_range)
    return str(message.header.frame_id), float(message.range), *span, float(message.field_of_view)


def _distance_mm(message: Any, kind: str, point: tuple[float, float, float] | None) -> float:
    """Return the distance in a message, mm; NaN where a range finder has no reading."""
    if point is not None and kind != RANGE_TYPE:
        at = POSITIONS[kind](message)
        return float(1000.0 * np.linalg.norm(np.array([at.x, at.y, at.z]) - np.array(point)))
    value = reading_mm(*(np.array([float(x)]) for x in (message.range, message.min_range, message.max_range)))[0][0]
    return float(value) if value > 0 else np.nan
