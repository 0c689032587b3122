"""ROS bags (ROS 1 .bag, ROS 2 folders, .db3, .mcap) that hold `sensor_msgs/Range`, as recordings. Needs rosbags.

What a `Range` means follows REP 117 and the message's own text:

| range | here |
|---|---|
| from `min_range` to below `max_range` | the reading |
| +Inf, `max_range` or beyond, and 0 | no echo |
| -Inf, below `min_range` (too close to tell), negative | no answer: something was there, nobody knows where |
| NaN | no answer |

A bag holds no truth. It comes from constants, from another topic, or from a table over time; a ping without a truth
close by in time is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from acquisition.errors import MissingExtraError, RecordingError, RecordingNotFoundError, SettingError
from acquisition.io.recording import Recording

Floats = NDArray[np.float64]
SUFFIXES = (".bag", ".mcap", ".db3")
RANGE = "sensor_msgs/msg/Range"
INFRARED = 1  # sensor_msgs/Range
NO_ECHO_MM, NO_ANSWER_MM = 0.0, np.nan
# where in a message a position is
POSITIONS: Mapping[str, Callable[[Any], Any]] = {
    "geometry_msgs/msg/PointStamped": lambda message: message.point,
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose.position,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose.position,
    "geometry_msgs/msg/TransformStamped": lambda message: message.transform.translation,
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose.position,
}
# columns of a table of truths, and their factor to a recording's column
TRUTHS: Mapping[str, tuple[str, float]] = {
    "distance_m": ("distance_mm", 1000.0),
    "distance_cm": ("distance_mm", 10.0),
    "distance_mm": ("distance_mm", 1.0),
    "angle_deg": ("angle_deg", 1.0),
    "incidence_deg": ("incidence_deg", 1.0),
    "reflectance": ("reflectance", 1.0),
}
CLOCKS = ("time_s", "stamp_s")
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Truth:
    """Where the true distance of each ping comes from; at most one of these.

    Attributes:
        topic: of a second ranger (`sensor_msgs/Range`), or of a position.
        point: that the reflector stands at, m, in the frame of the position; its distance is the truth.
        table: CSV with `time_s` (since the first ping) or `stamp_s` (by the bag's clock), and any of `TRUTHS`.
        longest_gap_s: between two truths across which to interpolate.
    """

    topic: str = ""
    point: tuple[float, float, float] | None = None
    table: Path | None = None
    longest_gap_s: float = 0.5

    def __post_init__(self) -> None:
        """Refuse two truths at once."""
        if self.topic and self.table:
            raise SettingError("truth: expected a topic or a table, got both")
        if not self.longest_gap_s > 0.0:
            raise SettingError(f"longest gap: expected more than 0 s, got {self.longest_gap_s:g} s")


@dataclass(frozen=True)
class Imported:
    """What came of a bag.

    Attributes:
        recording: of all chosen topics, in the order of time.
        left_out: pings for which there was no truth.
        too_close: pings that REP 117 calls too close to measure.
    """

    recording: Recording
    left_out: int
    too_close: int


@dataclass(frozen=True)
class Series:
    """Values over time: stamps in s, ascending, and columns of the same length."""

    stamp: Floats
    columns: Mapping[str, Floats] = field(default_factory=dict)

    def at(self, stamp: Floats, longest_gap_s: float) -> dict[str, Floats]:
        """Interpolate each column; nan before the first, behind the last and inside gaps that are too long."""
        after = np.searchsorted(self.stamp, stamp).clip(1, max(len(self.stamp) - 1, 1))
        inside = (stamp >= self.stamp[0]) & (stamp <= self.stamp[-1])
        if len(self.stamp) > 1:
            near = np.minimum(stamp - self.stamp[after - 1], self.stamp[after] - stamp) <= 1e-9
            inside &= near | (self.stamp[after] - self.stamp[after - 1] <= longest_gap_s)
        return {k: np.where(inside, np.interp(stamp, self.stamp, v), np.nan) for k, v in self.columns.items()}


def is_bag(path: Path) -> bool:
    """Tell whether a path is a bag by its name, or a folder with one in it."""
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").is_file()


def import_bag(
    path: Path,
    topics: Sequence[str] = (),
    truth: Truth | None = None,
    constants: Mapping[str, float | str] | None = None,
    progress: Progress | None = None,
) -> Imported:
    """Read the sonars of a bag as a recording; sensors are named by their frame.

    Args:
        path: of the bag.
        topics: of `sensor_msgs/Range`; all that are no infrared if none is given.
        truth: where the true distance comes from, unless `constants` has `distance_mm`.
        constants: columns that are the same in every row; `angle_deg` is 0 if nothing says otherwise.
        progress: called with messages read and messages in all.

    Raises:
        RecordingNotFoundError: no such file.
        RecordingError: no bag that can be read, no such topic, or no ping with a truth.
        SettingError: nothing tells the true distance.
        MissingExtraError: rosbags is not installed.
    """
    truth, constants = truth or Truth(), dict(constants or {})
    if not (truth.topic or truth.table or "distance_mm" in constants):
        raise SettingError(f"{path}: a bag holds no true distance; give a constant distance_mm, a topic or a table")
    with _Bag(path) as bag:
        chosen = bag.sonars(topics, truth.topic)
        pings = pd.concat([bag.pings(topic, progress) for topic in chosen], ignore_index=True)
        known = bag.positions(truth) if truth.topic else None
    if pings.empty:
        raise RecordingError(f"{path}: topic {', '.join(chosen)}: holds no message")
    pings = pings.sort_values("stamp_s", kind="stable", ignore_index=True)
    first = float(pings["stamp_s"].iloc[0])
    if truth.table:
        known = read_table(truth.table, first)
    stamp = pings["stamp_s"].to_numpy()
    given = {} if known is None else known.at(stamp, truth.longest_gap_s)
    held = np.all([np.isfinite(column) for column in given.values()] or [np.ones(len(pings), bool)], axis=0)
    table = pings.assign(time_s=stamp - first, session=path.name, **{"angle_deg": 0.0, **given, **constants})
    table, too_close = table[held], int(pings["too_close"].sum())
    if table.empty:
        raise RecordingError(
            f"{path}: no ping lies within {truth.longest_gap_s:g} s of a truth; check that both have the same clock"
        )
    return Imported(_recording(table, path), int((~held).sum()), too_close)


def _recording(table: pd.DataFrame, path: Path) -> Recording:
    table = table.drop(columns=["stamp_s", "too_close"]).reset_index(drop=True)
    number = table.select_dtypes("number")
    table[number.columns] = number.round(6)
    text = table.astype(object).where(table.notna(), "").map(_text)
    return Recording.from_text(text, str(path))


def _text(value: Any) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def read_table(path: Path, first_stamp: float) -> Series:
    """Read truths over time; `time_s` counts from `first_stamp`.

    Raises:
        RecordingNotFoundError: no such file.
        RecordingError: no clock, no truth, no number, or a clock that runs backwards.
    """
    if not path.is_file():
        raise RecordingNotFoundError(f"{path}: no such file; give a CSV with time_s and distance_m")
    try:
        table = pd.read_csv(path, skipinitialspace=True, encoding="utf-8-sig")
    except (pd.errors.EmptyDataError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: not a table of comma-separated values: {str(error).strip()}") from None
    clock = next((name for name in CLOCKS if name in table), None)
    known = [name for name in TRUTHS if name in table]
    if clock is None or not known:
        raise RecordingError(
            f"{path}, line 1: expected {' or '.join(CLOCKS)} and one or more of {', '.join(TRUTHS)}, "
            f"found {', '.join(map(str, table.columns))}"
        )
    number = table[[clock, *known]].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    faulty = np.argwhere(~np.isfinite(number))
    if not len(number) or len(faulty):
        line, column = (2, 0) if not len(number) else (int(faulty[0, 0]) + 2, int(faulty[0, 1]))
        raise RecordingError(f"{path}, line {line}, column {[clock, *known][column]}: expected a number")
    back = np.flatnonzero(np.diff(number[:, 0]) <= 0)
    if len(back):
        raise RecordingError(f"{path}, line {back[0] + 3}, column {clock}: expected more than in the line before")
    stamp = number[:, 0] + (first_stamp if clock == "time_s" else 0.0)
    return Series(stamp, {TRUTHS[n][0]: number[:, k] * TRUTHS[n][1] for k, n in enumerate(known, 1)})


def reading_mm(range_m: Floats, least_m: Floats, most_m: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return readings in the meaning of a recording, mm (nan: no answer), and which were too close to measure.

    >>> reading_mm(np.array([1.0, np.inf, -np.inf, np.nan]), np.full(4, 0.02), np.full(4, 4.0))[0]
    array([1000.,    0.,   nan,   nan])
    """
    silent = (range_m == 0.0) | ((most_m > 0.0) & (range_m >= most_m)) | np.isposinf(range_m)
    too_close = ~silent & (range_m < np.maximum(least_m, 0.0))
    reading = np.where(silent, NO_ECHO_MM, np.where(too_close, NO_ANSWER_MM, range_m * 1000.0))
    return reading, too_close


class _Bag:
    """An open bag; every fault of the file is one named error."""

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise RecordingNotFoundError(f"{path}: no such bag; give a .bag, .mcap or .db3 file, or a ROS 2 folder")
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ModuleNotFoundError:
            raise MissingExtraError("reading bags needs the package rosbags: pip install 'sonar-gym[ros]'") from None
        self.path = path
        # bags written before ROS 2 Iron hold no definitions; their messages are those of Humble
        self._open = lambda: AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))

    def __enter__(self) -> _Bag:
        self._reader = self._safely(lambda: self._open().__enter__())
        return self

    def __exit__(self, *error: object) -> None:
        self._reader.close()

    def _safely(self, work: Callable[[], Any]) -> Any:
        """Do something with the file; a broken one makes the library raise almost anything."""
        try:
            return work()
        except (RecordingError, KeyboardInterrupt, MemoryError):
            raise
        except Exception as error:
            told = " ".join(str(error).split()) or type(error).__name__
            raise RecordingError(f"{self.path}: not a bag that can be read: {told}") from error

    def _topics(self) -> dict[str, str]:
        return {name: str(info.msgtype) for name, info in self._reader.topics.items()}

    def sonars(self, asked: Sequence[str], truth: str) -> list[str]:
        """Return the topics to import."""
        there = [name for name, kind in self._topics().items() if kind == RANGE]
        for name in asked:
            self._expect(name, there)
        if not there:
            raise RecordingError(f"{self.path}: holds no topic of sensor_msgs/Range; found {self._told()}")
        chosen = list(asked) or [name for name in there if name != truth and not self._is_infrared(name)]
        if not chosen:
            raise RecordingError(f"{self.path}: {', '.join(there)}: infrared or the truth itself; give the topic")
        return chosen

    def _expect(self, name: str, there: Sequence[str]) -> None:
        if name not in there:
            raise RecordingError(f"{self.path}: topic {name!r} is none of {', '.join(there) or self._told()}")

    def _told(self) -> str:
        return ", ".join(f"{name} ({kind})" for name, kind in self._topics().items()) or "no topic at all"

    def _is_infrared(self, topic: str) -> bool:
        first = next(self._messages(topic), None)
        return first is not None and first[1].radiation_type == INFRARED

    def _messages(self, topic: str, progress: Progress | None = None) -> Iterator[tuple[float, Any]]:
        """Yield stamp, s, and message; the stamp is the header's, or when it was received where that is empty."""
        info = self._reader.topics[topic]
        connections = [c for c in self._reader.connections if c.topic == topic]
        for number, (connection, received, raw) in enumerate(self._reader.messages(connections), 1):
            message = self._reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            yield (stamp if stamp > 0.0 else received * 1e-9), message
            if progress is not None and (number % 500 == 0 or number == info.msgcount):
                progress(number, info.msgcount)

    def pings(self, topic: str, progress: Progress | None) -> pd.DataFrame:
        """Return a row a message of a sonar."""
        found = self._safely(lambda: [(stamp, *_ranger(m)) for stamp, m in self._messages(topic, progress)])
        names = ["stamp_s", "sensor", "range", "least", "most", "view"]
        table = pd.DataFrame(found, columns=names)
        reading, too_close = reading_mm(*(table[name].to_numpy(np.float64) for name in ("range", "least", "most")))
        return pd.DataFrame(
            {
                "stamp_s": table["stamp_s"].astype(np.float64),
                "sensor": table["sensor"].replace("", topic),
                "reading_mm": reading,
                "field_of_view_deg": np.rad2deg(table["view"].to_numpy(np.float64)),
                "min_range_mm": table["least"].to_numpy(np.float64) * 1000.0,
                "max_range_mm": table["most"].to_numpy(np.float64) * 1000.0,
                "too_close": too_close,
            }
        )

    def positions(self, truth: Truth) -> Series:
        """Return the truth that a topic tells, as distances over time."""
        kinds = self._topics()
        self._expect(truth.topic, [name for name, kind in kinds.items() if kind == RANGE or kind in POSITIONS])
        kind = kinds[truth.topic]
        if kind != RANGE and truth.point is None:
            raise SettingError(f"{truth.topic}: tells a position; give the point that the reflector stands at")
        found = self._safely(lambda: [(s, _distance_mm(m, kind, truth.point)) for s, m in self._messages(truth.topic)])
        known = np.array(found, dtype=np.float64).reshape(-1, 2)
        known = known[np.isfinite(known).all(axis=1)]
        known = known[np.unique(known[:, 0], return_index=True)[1]]
        if not len(known):
            raise RecordingError(f"{self.path}: topic {truth.topic}: tells no distance at all")
        return Series(known[:, 0], {"distance_mm": known[:, 1]})


def _ranger(message: Any) -> tuple[str, float, float, float, float]:
    span = float(message.min_range), float(message.max_range)
    return message.header.frame_id, float(message.range), *span, float(message.field_of_view)


def _distance_mm(message: Any, kind: str, point: tuple[float, float, float] | None) -> float:
    """Return the distance that a message tells, mm; nan where a ranger found nothing."""
    if point is not None and kind != RANGE:
        at = POSITIONS[kind](message)
        return float(1000.0 * np.linalg.norm(np.array([at.x, at.y, at.z]) - np.array(point)))
    value = reading_mm(*(np.array([float(x)]) for x in (message.range, message.min_range, message.max_range)))[0][0]
    return float(value) if value > 0 else np.nan
