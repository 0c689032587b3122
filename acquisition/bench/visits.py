"""Grouping of pings into visits (one placement of the reflector) and segments of constant air."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import Floats, Ints
from acquisition.ping import Ping

BATCH = 256  # pings per batch: about 10 MB of waveforms
TILT = "tilt_back"  # covariate: tilt of the top of the reflector towards the sensor, rad
SEGMENT_C = 0.4  # degC, width of the temperature bins into which a visit is divided


@dataclass(frozen=True)
class Visits:
    """Assignment of n pings to visits, and of visits to segments of one air and one register setting.

    Attributes:
        start: whether a ping is the first of its visit, (n,).
        visit: visit of each ping, (n,).
        segment: segment of each ping, (n,).
        first: index of one ping of each segment, (segments,).
        temperature_c, humidity_pct: mean over each segment, (segments,).
    """

    start: NDArray[np.bool_]
    visit: Ints
    segment: Ints
    first: Ints
    temperature_c: Floats
    humidity_pct: Floats

    @classmethod
    def of(cls, ping: Ping, temperature_c: Floats, humidity_pct: Floats, setting: Ints) -> Visits:
        """Group pings with contiguous runs and all covariates; `setting` is the number of their registers, (n,)."""
        given = [ping.covariates[name] for name in ("humidity_pct", TILT)]
        table = np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.run, *given])
        start = np.ones(len(ping), dtype=np.bool_)
        start[1:] = (table[:, 1:] != table[:, :-1]).any(axis=0)
        visit = np.cumsum(start) - 1
        mean_c = _mean(temperature_c, visit)[visit]
        step = np.rint((temperature_c - mean_c) / SEGMENT_C)
        code = (step - step.min(initial=0.0)).astype(np.int64)
        codes = code * (setting.max(initial=0) + 1) + setting
        _, first, segment = np.unique(
            visit * (codes.max(initial=0) + 1) + codes, return_index=True, return_inverse=True
        )
        return cls(start, visit, segment, first, _mean(temperature_c, segment), _mean(humidity_pct, segment))

    def batches(self, which: NDArray[np.bool_]) -> Iterator[tuple[Ints, Ints]]:
        """Yield pings and their segments in batches of whole segments, or parts of a segment longer than a batch.

        Args:
            which: mask of the pings to include, (n,).
        """
        pings = np.flatnonzero(which)
        pings = pings[np.argsort(self.segment[pings], kind="stable")]
        edges = np.flatnonzero(np.diff(self.segment[pings], prepend=-1, append=-1))
        begin = 0
        while begin < len(pings):
            whole = edges[(edges > begin) & (edges <= begin + BATCH)]
            end = int(whole[-1]) if len(whole) else begin + BATCH
            yield pings[begin:end], np.unique(self.segment[pings[begin:end]])
            begin = end


def _mean(value: Floats, index: Ints) -> Floats:
    return np.asarray(np.bincount(index, value) / np.maximum(np.bincount(index), 1))
