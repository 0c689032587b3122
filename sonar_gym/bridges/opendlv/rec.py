"""`.rec` files of OpenDLV: envelopes one after the other, into a recording and back.

A `.rec` file has no true distances. They come from the Frames of the car and a map, or from a table over time. It has
no silence either, because OpenDLV's drivers publish nothing without an echo: where a sensor's period is known, a ping
without a reading is recorded as no echo.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from acquisition import EchoStatus, Ping, Reading, Recording, RecordingError, RecordingNotFoundError, SettingError
from acquisition.arguments import checked
from acquisition.arrays import Floats
from acquisition.io.files import is_file, write_bytes
from acquisition.io.logs.bags import TimeSeries
from acquisition.io.logs.foreign import check_once
from sonar_gym.bridges.opendlv.messages import FRAME, HEADER, HEADER_SIZE, INT32, READING, encode
from sonar_gym.bridges.opendlv.session import seconds_of, time_of
from sonar_gym.bridges.opendlv.walls import interpolate_pose
from sonar_gym.bridges.opendlv.wire import Envelope, decode
from sonar_gym.sensing.mounts import Mount, in_world, mount_arrays
from sonar_gym.sensing.scene import Scene

MAX_SILENT = 1_000_000  # pings of a sensor that are added as no echo


@dataclass(frozen=True)
class Geometry:
    """True distances from Frames and a map.

    Attributes:
        scene: the walls.
        mounts: the sensors; senderStamp k is mount k.
        frame_id: senderStamp of the car's Frame.
        max_range: distance beyond which a ping faces nothing, m.
    """

    scene: Scene
    mounts: Sequence[Mount]
    frame_id: int = 0
    max_range: float = 11.0


@checked
def read_rec(path: Path) -> Iterator[Envelope]:
    """Yield the envelopes of a file.

    Raises:
        RecordingNotFoundError: the file does not exist.
        RecordingError: the file is no `.rec` file, or damaged; a last envelope that was cut off is left out.
    """
    if not is_file(path):
        raise RecordingNotFoundError(f"{path}: no such file; give a .rec file of OpenDLV")
    with path.open("rb") as file:
        at = 0
        while head := file.read(HEADER_SIZE):
            if head[:2] != HEADER[: len(head)]:
                raise RecordingError(f"{path}, byte {at}: expected the beginning of an envelope (0d a4)")
            size = int.from_bytes(head[2:], "little")
            body = file.read(size)
            if len(head) < HEADER_SIZE or len(body) < size:  # the recorder was stopped while it wrote
                return
            yield from decode(head + body)
            at += HEADER_SIZE + size


@checked
def first_stamp(path: Path) -> float:
    """Return the time of the first reading of a file, s since 1970, from which `time_s` of a table counts."""
    return min((seconds_of(e.sampled) for e in read_rec(path) if e.message == READING), default=0.0)


@checked
def recording_of(
    path: Path,
    truth: Geometry | TimeSeries | None = None,
    period_s: float = 0.0,
    longest_gap_s: float = 0.5,
    constants: Mapping[str, float | str] | None = None,
) -> Recording:
    """Return the DistanceReadings of a `.rec` file as a recording; the sensor is the senderStamp.

    Args:
        path: of the file.
        truth: geometry, or true values over time (columns of a recording; times in s since 1970), unless `constants`
            has `distance_mm`.
        period_s: time between two pings of a sensor, s; 0 leaves the pings without an echo out.
        longest_gap_s: longest gap between two Frames or true values that is interpolated, s.
        constants: columns with one value in all rows.

    Raises:
        SettingError: the true distance has no source, or a column has two.
        RecordingError: the file has no reading, no Frame, or none of them at the same time.
    """
    constants = constants or {}
    if truth is None and "distance_mm" not in constants:
        raise SettingError(f"{path}: a .rec file has no true distance; give a map, a table, or a constant distance_mm")
    envelopes = [e for e in read_rec(path) if e.message in (READING, FRAME)]
    pings = _pings([e for e in envelopes if e.message == READING], path, period_s)
    if isinstance(truth, Geometry):
        known = _seen(truth, envelopes, pings, path, longest_gap_s)
    else:
        stamp = pings["stamp_s"].to_numpy()
        known = pd.DataFrame({} if truth is None else truth.interpolate(stamp, longest_gap_s), index=pings.index)
    check_once([*map(str, known), *constants])
    columns: dict[str, Any] = {"angle_deg": 0.0, **{str(name): known[name] for name in known}, **constants}
    table = pings.assign(**columns)
    table = table[np.isfinite(table["distance_mm"].to_numpy()) & np.isfinite(table["angle_deg"].to_numpy())]
    if table.empty:
        raise RecordingError(f"{path}: no reading lies within {longest_gap_s:g} s of a true distance; check the clocks")
    first = float(table["stamp_s"].iloc[0])
    columns = {"time_s": (table["stamp_s"] - first).round(6), "session": path.stem, **constants}
    return Recording.from_text(table.assign(**columns).drop(columns="stamp_s").astype(str), str(path))


def _pings(readings: Sequence[Envelope], path: Path, period_s: float) -> pd.DataFrame:
    """Return time, sensor and reading, mm, of all pings in chronological order; doubled messages count once."""
    if not readings:
        raise RecordingError(f"{path}: has no {READING}")
    rows = {(e.sender_stamp, e.sampled): e.fields["distance"] for e in readings}
    table = pd.DataFrame(
        [(seconds_of(sampled), f"{stamp}", 1000.0 * distance) for (stamp, sampled), distance in rows.items()],
        columns=["stamp_s", "sensor", "reading_mm"],
    )
    table["reading_mm"] = table["reading_mm"].round(3)
    valid = np.isfinite(table["reading_mm"].to_numpy()) & (table["reading_mm"].to_numpy() >= 0.0)
    table = table[valid]
    if period_s > 0.0 and len(table):
        table = pd.concat([_with_silence(group, period_s) for _, group in table.groupby("sensor", sort=False)])
    return table.sort_values(["stamp_s", "sensor"], kind="stable", ignore_index=True)


def _with_silence(group: pd.DataFrame, period_s: float) -> pd.DataFrame:
    """Return the pings of a sensor with those added, as no echo, that published nothing."""
    stamp = np.sort(group["stamp_s"].to_numpy())
    if (stamp[-1] - stamp[0]) / period_s > MAX_SILENT + len(stamp):
        raise SettingError(
            f"period: {period_s:g} s leaves more than {MAX_SILENT:,} pings without an echo; "
            "expected the time between two pings of a sensor"
        )
    added = []
    for before, gap in zip(stamp[:-1], np.diff(stamp), strict=True):
        missing = round(gap / period_s) - 1
        added += [before + gap * k / (missing + 1) for k in range(1, missing + 1)]
    silent = pd.DataFrame({"stamp_s": added, "sensor": group["sensor"].iloc[0], "reading_mm": 0.0})
    return pd.concat([group, silent], ignore_index=True) if added else group


def _seen(
    truth: Geometry, envelopes: Sequence[Envelope], pings: pd.DataFrame, path: Path, longest_gap_s: float
) -> pd.DataFrame:
    """Return the conditions of the pings from the geometry; NaN without a Frame close in time or beyond the mounts."""
    frames = {seconds_of(e.sampled): e.fields for e in envelopes if _is_frame(e, truth.frame_id)}
    if not frames:
        raise RecordingError(f"{path}: has no {FRAME} with senderStamp {truth.frame_id}, from which distances follow")
    times = np.array(sorted(frames))
    poses = np.array([[frames[t][name] for name in ("x", "y", "yaw")] for t in times])
    stamp, sensor = pings["stamp_s"].to_numpy(), pings["sensor"].astype(np.int64).to_numpy()
    inside = np.isfinite(TimeSeries(times, {"x": poses[:, 0]}).interpolate(stamp, longest_gap_s)["x"])
    at = interpolate_pose(times, poses, stamp)
    return pd.DataFrame(
        {
            name: np.where(inside & (sensor < len(truth.mounts)), column, np.nan)
            for name, column in _conditions(truth, at, np.minimum(sensor, len(truth.mounts) - 1)).items()
        }
    )


def _is_frame(envelope: Envelope, frame_id: int) -> bool:
    mine = envelope.message == FRAME and envelope.sender_stamp == frame_id
    return mine and bool(np.all(np.isfinite([envelope.fields[name] for name in ("x", "y", "yaw")])))


def _conditions(truth: Geometry, poses: Floats, sensor: Floats) -> dict[str, Floats]:
    """Return the conditions of pings from poses of the car, (n, 3), by column of a recording."""
    mounts, half = mount_arrays(truth.mounts)
    out = np.empty((4, len(poses)))
    for k, (pose, i) in enumerate(zip(poses, sensor, strict=True)):
        hits = truth.scene.cast(in_world(mounts[i : i + 1], pose), half[i : i + 1], truth.max_range)
        seen = hits.in_cone[0]
        out[:, k] = hits.distance[0] if seen else np.nan, hits.bearing[0], hits.incidence[0], hits.reflectance[0]
    distance, bearing, incidence, reflectance = out
    return {
        "distance_mm": 1000.0 * distance,
        "angle_deg": np.degrees(bearing),
        "incidence_deg": np.degrees(incidence),
        "reflectance": reflectance,
    }


@checked
def write_rec(recording: Recording, path: Path, start_s: float) -> int:
    """Write the echoes of a recording as DistanceReadings, in chronological order, and return their number.

    Pings without echo or answer leave nothing, as in OpenDLV. The senderStamp is the name of the sensor if that is a
    number, else its place among the sensors.

    Args:
        recording: the recording; sessions follow each other by their times.
        path: of the file.
        start_s: time of `time_s` = 0, s since 1970.
    """
    ping, reading, names = recording.ping, recording.reading, _sensor_names(recording)
    if not 0.0 <= start_s + float(ping.time.max()) < INT32[1]:
        raise SettingError(f"start_s: must lie in [0, {INT32[1]}] s since 1970, got {start_s:g} s")
    stamps = _stamps(names)
    order = np.argsort(ping.time, kind="stable")
    rows = order[reading.status[order] == EchoStatus.ECHO]
    write_bytes(path, b"".join(_row(ping, reading, int(k), stamps[names[k]], start_s) for k in rows))
    return len(rows)


def _row(ping: Ping, reading: Reading, k: int, stamp: int, start_s: float) -> bytes:
    at = time_of(start_s + float(ping.time[k]))
    distance = {"distance": float(reading.range[k])}
    return encode(READING, distance, sender_stamp=stamp, sent=at, received=at, sampled=at)


def _sensor_names(recording: Recording) -> list[str]:
    return list(recording.table["sensor"].astype(str)) if recording.has("sensor") else ["0"] * len(recording)


def _stamps(names: Sequence[str]) -> dict[str, int]:
    unique = list(dict.fromkeys(names))
    numbers = all(name.isdecimal() and int(name) < 2**32 for name in unique)
    return {name: int(name) if numbers else k for k, name in enumerate(unique)}
