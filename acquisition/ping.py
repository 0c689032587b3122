"""`Ping`, the true conditions of n pings, and `Reading`, the output of the sensor, as arrays in SI units.

"No echo" (`EchoStatus.NO_ECHO`) is a measurement, "no answer" (`EchoStatus.NO_ANSWER`) is a failed connection.
Neither is encoded as NaN or as maximum range.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sized
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.arguments import checked
from acquisition.arrays import Bits, Floats, Ints
from acquisition.brief import brief
from acquisition.errors import SettingError
from acquisition.limits import as_numbers, as_whole, shown

TEMPERATURE = "temperature_c"  # covariate: a thermometer at the sensor, degC
RANGE_RATE = "range_rate_mps"  # covariate: speed of the reflector away from the sensor, m/s
CREDENCE_TOLERANCE = 0.1  # Esmi (2016), section 4.1: a reading is right within +-10 % of the true distance
CELSIUS = 273.15  # K; 0 degC
MAX_RANGE = 1700.0  # m, of a reading: any 16-bit count, also in inches, since transmission errors can set every bit


class EchoStatus(IntEnum):
    """Outcome of a ping."""

    NO_ECHO = 0
    ECHO = 1
    NO_ANSWER = 2


_ECHO = int(EchoStatus.ECHO)  # looking up an enum member takes longer than comparing eight readings


def _broadcast(name: str, array: Floats, n: int) -> Floats:
    try:
        return np.ascontiguousarray(np.broadcast_to(array, (n,)))
    except ValueError:
        raise SettingError(f"{name} has shape {array.shape}, expected {(n,)}: pass one value per ping") from None


def _picked(name: str, index: Any) -> Any:
    """Return a slice, or an array of bool or indices; numpy reports those that are out of range."""
    if isinstance(index, slice):
        return index
    try:
        rows = np.atleast_1d(np.asarray(index))
    except (MemoryError, RuntimeError, ValueError):  # lists of unequal lengths, or a tensor with a gradient
        rows = np.array([None])
    if rows.dtype.kind not in "iub" and rows.size:
        raise SettingError(f"{name}[...]: expected a mask, a slice or indices, got {shown(index)}")
    return rows if rows.size else rows.astype(np.int64)


def check_pairs(name: str, ping: Sized, reading: Reading | None) -> None:
    """Raise SettingError unless there is one reading for each ping, or ping of a law."""
    if reading is not None and len(reading) != len(ping):
        raise SettingError(f"{name}: expected one reading for each ping, got {len(reading)} for {len(ping)}")


@dataclass(frozen=True)
class Ping:
    """True conditions of n pings.

    Attributes:
        distance: true slant distance to the reflector, m, (n,).
        angle: bearing of the reflector off the beam axis, rad, (n,).
        incidence: angle between beam and surface normal, rad, (n,).
        reflectance: of the reflector, 0..1, (n,); 0.1 rubber, 0.9 mirror in Esmi (2016).
        time: since the start of the recording, s, (n,).
        run: index of the uninterrupted run (session and sensor) of each ping, (n,) int.
        covariates: further logged quantities by column name (with its unit), each (n,). A law uses those that it knows;
            a learned law warns once of others, any other law ignores them.
    """

    __repr__ = brief

    distance: Floats
    angle: Floats
    incidence: Floats
    reflectance: Floats
    time: Floats
    run: Ints
    covariates: Mapping[str, Floats] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        distance: ArrayLike,
        angle: ArrayLike = 0.0,
        incidence: ArrayLike | None = None,
        reflectance: ArrayLike = 1.0,
        time: ArrayLike | None = None,
        run: ArrayLike = 0,
        **covariates: ArrayLike,
    ) -> Ping:
        """Broadcast scalars and arrays to one batch; `incidence` defaults to `angle`, `time` to the ping index.

        >>> Ping.of(distance=[1.0, 2.0], angle=0.1).incidence
        array([0.1, 0.1])
        """
        given = {"distance": distance, "angle": angle, "reflectance": reflectance, "run": run, **covariates}
        given |= {name: x for name, x in (("incidence", incidence), ("time", time)) if x is not None}
        short = {name: np.atleast_1d(as_numbers(f"Ping.{name}", x)) for name, x in given.items()}
        n = max(x.shape[0] for x in short.values())
        row = {name: _broadcast(f"Ping.{name}", x, n) for name, x in short.items()}
        return cls(
            distance=row["distance"],
            angle=row["angle"],
            incidence=row.get("incidence", row["angle"]),
            reflectance=row["reflectance"],
            time=row.get("time", np.arange(n, dtype=np.float64)),
            run=as_whole("Ping.run", row["run"]),
            covariates={name: row[name] for name in covariates},
        )

    def __post_init__(self) -> None:
        """Raise SettingError for unequal shapes, values that are not finite and negative distances."""
        n = getattr(self.distance, "shape", ())
        for name in ("distance", "angle", "incidence", "reflectance", "time", "run"):
            value = getattr(self, name)
            if not isinstance(value, np.ndarray):
                raise SettingError(f"Ping.{name}: expected an array, got {shown(value)}; `Ping.of` takes lists, too")
            if value.dtype.kind not in "fiu":
                raise SettingError(f"Ping.{name}: expected an array of numbers, got {shown(value)}")
            if value.shape != n or value.ndim != 1:
                raise SettingError(f"Ping.{name} has shape {value.shape}, expected {n}: pass one value per ping")
            # a finite sum of squares implies finite terms, and is one fast call: simulators build a Ping every step
            with np.errstate(over="ignore"):
                finite = math.isfinite(value @ value)
            if not finite:
                raise SettingError(
                    f"Ping.{name} holds a value that is not finite, or is too large: give the true condition of every "
                    "ping"
                )
        if not isinstance(self.covariates, Mapping):
            raise SettingError(f"Ping.covariates: expected a mapping of arrays, got {shown(self.covariates)}")
        if len(self.distance) and self.distance.min() < 0:
            raise SettingError(f"Ping.distance must be >= 0 m, got {self.distance.min():g} m")

    def __len__(self) -> int:
        """Return the number of pings."""
        return int(self.distance.shape[0])

    def __getitem__(self, index: ArrayLike | slice) -> Ping:
        """Return the pings at a mask, slice or array of indices."""
        pick = _picked("Ping", index)
        parts = {k: getattr(self, k)[pick] for k in ("distance", "angle", "incidence", "reflectance", "time", "run")}
        return replace(self, **parts, covariates={k: v[pick] for k, v in self.covariates.items()})


@dataclass(frozen=True)
class Reading:
    """Output of the sensor for n pings.

    Attributes:
        range: reported range of the first echo, m, (n,); 0 where `status` is not ECHO.
        status: an `EchoStatus` for each ping, (n,) uint8.
        echoes: ranges of the echoes after the first, m, (n, k); 0 where there is none.
    """

    __repr__ = brief

    range: Floats
    status: NDArray[np.uint8]
    echoes: Floats = field(default_factory=lambda: np.empty((0, 0)))

    @classmethod
    def of(cls, range_: ArrayLike, status: ArrayLike | None = None, echoes: ArrayLike | None = None) -> Reading:
        """Build readings; without `status`, 0 means no echo and a positive value an echo.

        >>> Reading.of([0.0, 1.5]).echo
        array([False,  True])
        """
        value = np.ascontiguousarray(np.atleast_1d(as_numbers("Reading.range", range_)))
        own = np.where(value > 0, EchoStatus.ECHO, EchoStatus.NO_ECHO)
        code = own if status is None else np.atleast_1d(as_numbers("Reading.status", status))
        if not ((code >= 0) & (code <= max(EchoStatus))).all():
            raise SettingError("Reading.status must hold values of EchoStatus: 0 no echo, 1 echo, 2 no answer")
        more = np.empty((len(value), 0)) if echoes is None else as_numbers("Reading.echoes", echoes)
        return cls(value, code.astype(np.uint8), more)

    def __post_init__(self) -> None:
        """Raise SettingError where range and status contradict each other or a range is impossible."""
        for name in ("range", "status", "echoes"):
            if not isinstance(getattr(self, name), np.ndarray):
                given = shown(getattr(self, name))
                raise SettingError(f"Reading.{name}: expected an array, got {given}; `Reading.of` takes lists, too")
            if getattr(self, name).dtype.kind not in "fiub":
                raise SettingError(f"Reading.{name}: expected an array of numbers, got {shown(getattr(self, name))}")
        if self.range.shape != self.status.shape:
            raise SettingError(f"Reading.status has shape {self.status.shape}, expected {self.range.shape}")
        # comparisons with NaN are false, so NaN fails `range >= 0`
        if not (((self.range > 0) == self.echo) & (self.range >= 0) & (self.range <= MAX_RANGE)).all():
            raise SettingError(
                f"Reading.range must be > 0 m and at most {MAX_RANGE:.0f} m where there is an echo and 0 elsewhere"
            )

    def __len__(self) -> int:
        """Return the number of readings."""
        return int(self.range.shape[0])

    def __getitem__(self, index: ArrayLike | slice) -> Reading:
        """Return the readings at a mask, slice or array of indices."""
        pick = _picked("Reading", index)
        more = self.echoes[pick] if len(self.echoes) == len(self) else self.echoes
        return Reading(self.range[pick], self.status[pick], more)

    @property
    def echo(self) -> Bits:
        """Mask of the pings with an echo, (n,)."""
        return self.status == _ECHO

    @property
    def answered(self) -> Bits:
        """Mask of the pings that the sensor answered, (n,)."""
        return self.status != EchoStatus.NO_ANSWER


@checked
def previous(reading: Reading, run: Ints) -> Reading:
    """Return the previous reading of the same run for each ping; status NO_ANSWER for the first ping of a run.

    Args:
        reading: n readings, in chronological order within each run.
        run: index of the run of each reading, (n,).
    """
    run = as_numbers("previous.run", run).astype(np.int64)
    if run.shape != reading.range.shape:
        raise SettingError(f"previous.run has shape {run.shape}, expected {reading.range.shape}: one run per reading")
    order = np.argsort(run, kind="stable")
    before = np.full(len(run), -1)
    same = run[order][1:] == run[order][:-1]
    before[order[1:][same]] = order[:-1][same]
    first = before < 0
    value = np.where(first, 0.0, reading.range[before])
    status = np.where(first, EchoStatus.NO_ANSWER, reading.status[before])
    return Reading.of(value, status)


def interval(time: Floats, run: Ints) -> Floats:
    """Return the time since the previous ping of the same run, s, (n,); 0 for the first ping of a run.

    Args:
        time: of each ping, s, (n,), in chronological order within each run.
        run: index of the run of each ping, (n,).

    >>> interval(np.array([0.0, 0.5, 0.0, 0.7]), np.array([0, 0, 1, 0]))
    array([0. , 0.5, 0. , 0.2])
    """
    order = np.argsort(run, kind="stable")
    same = run[order][1:] == run[order][:-1]
    since = np.zeros(len(run))
    since[order[1:]] = np.where(same, np.diff(time[order]), 0.0)
    return since
