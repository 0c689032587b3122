"""The messages of the sonar server: length-prefixed, little-endian, plain numbers.

Every message is its length after the first four bytes (uint32), four letters, and a body:

| message | from | body |
|---|---|---|
| `PING` | client | n and length of the names (uint32), names of c covariates with commas (ASCII), n rows |
| `SEED` | client | seed (uint64): begin anew with empty memory; answered by a `READ` without readings |
| `READ` | server | n (uint32), n rows of three doubles: range, status, credence |
| `FAIL` | server | text (UTF-8): what is wrong |

A row of `PING` has 6 + c doubles: distance, m (infinite if nothing is in the beam); bearing of the reflector off the
beam axis, rad; incidence, rad; reflectance, 0..1; time, s; number of the sensor; then the covariates, in the units of
a recording. Of the readings, the range is in m and 0 without an echo; the status is 0 for no echo, 1 for an echo, 2 for
no answer; the credence is the probability that the reading is within 10 % of the true distance, given the reading.
"""

from __future__ import annotations

import struct

import numpy as np

from acquisition import EchoStatus, Ping, Reading, SettingError
from acquisition.arguments import checked
from acquisition.arrays import Floats
from sonar_gym.sensing.scene import EMPTY_M

PING, SEED, READ, FAIL = b"PING", b"SEED", b"READ", b"FAIL"
CONDITIONS = ("distance", "bearing", "incidence", "reflectance", "time", "sensor")
READINGS = ("range", "status", "credence")
MAX_PINGS = 8192  # in a message
MAX_SENSORS = 65_536
MAX_NAMES = 1024  # bytes
MAX_BODY = 4 + 8 + MAX_NAMES + MAX_PINGS * 8 * 64  # bytes after the length
HEAD = struct.Struct("<I")
COUNTS = struct.Struct("<II")
SEED_BODY = struct.Struct("<Q")
DOUBLE = np.dtype("<f8")


def framed(kind: bytes, body: bytes) -> bytes:
    """Return a message with its length."""
    return HEAD.pack(len(kind) + len(body)) + kind + body


@checked
def ping_message(ping: Ping) -> bytes:
    """Return the request for the readings of pings.

    Raises:
        SettingError: the pings are too many, or have a covariate that cannot be named.
    """
    if any("," in name or not name.isascii() or not name for name in ping.covariates):
        raise SettingError(f"request: covariates {list(ping.covariates)}: expected ASCII names without commas")
    names = ",".join(ping.covariates).encode("ascii")
    if len(ping) > MAX_PINGS or len(names) > MAX_NAMES:
        raise SettingError(f"request: at most {MAX_PINGS} pings and {MAX_NAMES} bytes of names, got {len(ping)} pings")
    columns = [ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.time, ping.run]
    rows = np.column_stack([*columns, *ping.covariates.values()]).astype(DOUBLE)
    return framed(PING, COUNTS.pack(len(ping), len(names)) + names + rows.tobytes())


@checked
def ping_of(body: bytes) -> Ping:
    """Return the pings of a request.

    Raises:
        SettingError: the request contradicts the protocol, or a value is outside its limits.
    """
    if len(body) < COUNTS.size:
        raise SettingError(f"PING: expected {COUNTS.size} bytes or more, got {len(body)}")
    n, length = COUNTS.unpack_from(body)
    start = COUNTS.size + length
    names = body[COUNTS.size : start].decode("ascii", "replace")
    covariates = names.split(",") if names else []
    size = n * 8 * (len(CONDITIONS) + len(covariates))
    if n > MAX_PINGS or length > MAX_NAMES or len(body) != start + size:
        raise SettingError(
            f"PING: {n} pings (at most {MAX_PINGS}) with {len(covariates)} covariates need {start + size} bytes, "
            f"got {len(body)}"
        )
    if len(set(covariates)) != len(covariates) or "" in covariates:
        raise SettingError(f"PING: covariates {names!r}: expected different names separated by commas")
    rows = np.frombuffer(body, DOUBLE, offset=start).reshape(n, len(CONDITIONS) + len(covariates)).astype(np.float64)
    return checked_pings(rows, covariates)


def checked_pings(rows: Floats, covariates: list[str]) -> Ping:
    """Return the pings of rows with the columns `CONDITIONS` and covariates.

    Raises:
        SettingError: a value is outside its limits.
    """
    distance, bearing, incidence, reflectance, time, sensor = np.ascontiguousarray(rows[:, : len(CONDITIONS)].T)
    distance = np.where(distance == np.inf, EMPTY_M, distance)
    limits = {
        "distance": (distance, 0.0, 1000.0, "m"),
        "bearing": (bearing, -np.pi, np.pi, "rad"),
        "incidence": (incidence, -np.pi, np.pi, "rad"),
        "reflectance": (reflectance, 0.0, 1.0, ""),
        "time": (time, -1e12, 1e12, "s"),
        "sensor": (sensor, 0.0, MAX_SENSORS - 1.0, ""),
    }
    for name, (value, low, high, unit) in limits.items():
        bad = ~((value >= low) & (value <= high))
        if bad.any():
            raise SettingError(f"PING: {name} must lie in [{low:g}, {high:g}] {unit}, got {value[bad][0]:g} {unit}")
    more = {name: np.ascontiguousarray(rows[:, len(CONDITIONS) + k]) for k, name in enumerate(covariates)}
    if not all(np.all(np.isfinite(value)) for value in more.values()):
        raise SettingError(f"PING: a covariate ({', '.join(covariates)}) is not finite")
    return Ping(distance, bearing, incidence, reflectance, time, sensor.astype(np.int64), more)


def read_message(reading: Reading, credence: Floats) -> bytes:
    """Return the answer to a request."""
    rows = np.column_stack([reading.range, reading.status, credence]).astype(DOUBLE)
    return framed(READ, HEAD.pack(len(reading)) + rows.tobytes())


@checked
def reading_of(body: bytes) -> tuple[Reading, Floats]:
    """Return the readings of an answer, and the credence of each, (n,).

    Raises:
        SettingError: the answer contradicts the protocol.
    """
    size = (len(body) - HEAD.size) // (8 * len(READINGS))
    if len(body) < HEAD.size or HEAD.unpack_from(body)[0] != size or len(body) != HEAD.size + size * 24:
        raise SettingError(
            f"READ: {len(body)} bytes do not hold the readings that they announce; is it a sonar server?"
        )
    range_, status, credence = np.frombuffer(body, DOUBLE, offset=HEAD.size).reshape(size, 3).T
    if not np.isin(status, list(EchoStatus)).all() or not np.all((credence >= 0.0) & (credence <= 1.0)):
        raise SettingError("READ: a status or credence is outside its limits; is it a sonar server?")
    return Reading(range_.astype(np.float64), status.astype(np.uint8)), credence.astype(np.float64)
