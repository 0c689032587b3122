"""Visits: stretches of pings of one condition, for which the reflector is placed once and the air hardly changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.bench.acoustics.air import Floats
from acquisition.bench.acoustics.arrivals import Integers
from acquisition.ping import Ping

BATCH = 256  # pings worked on at once: about 10 MB of waveforms
VISIT_C = 0.4  # degC; pings of a visit whose air differs more get waveforms of their own


@dataclass(frozen=True)
class Visits:
    """How n pings fall into visits, and visits into takes of one air and one setting of the registers.

    Attributes:
        start: whether a ping is the first of its visit, (n,).
        visit: number of each ping's visit, (n,).
        take: number of each ping's take, (n,).
        first: a ping of each take, (takes,).
        temperature_c, humidity_pct: mean over each take, (takes,).
    """

    start: NDArray[np.bool_]
    visit: Integers
    take: Integers
    first: Integers
    temperature_c: Floats
    humidity_pct: Floats

    @classmethod
    def of(cls, ping: Ping, temperature_c: Floats, humidity_pct: Floats, reset: NDArray[np.bool_]) -> Visits:
        """Sort pings that stand run by run."""
        given = ping.covariates.get("humidity_pct", np.zeros(len(ping)))
        table = np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.run, given])
        start = np.ones(len(ping), dtype=np.bool_)
        start[1:] = (table[:, 1:] != table[:, :-1]).any(axis=0)
        visit = np.cumsum(start) - 1
        middle = _mean(temperature_c, visit)[visit]
        step = np.rint((temperature_c - middle) / VISIT_C)
        code = np.stack([step - step.min(initial=0.0), reset]).astype(np.int64)
        kinds = code[0] * 2 + code[1]
        _, first, take = np.unique(visit * (kinds.max(initial=0) + 1) + kinds, return_index=True, return_inverse=True)
        return cls(start, visit, take, first, _mean(temperature_c, take), _mean(humidity_pct, take))

    def batches(self, which: NDArray[np.bool_]) -> Iterator[tuple[Integers, Integers]]:
        """Yield pings and their takes in batches of whole takes, or parts of one that is longer than a batch.

        Args:
            which: of the pings are wanted, (n,).
        """
        pings = np.flatnonzero(which)
        pings = pings[np.argsort(self.take[pings], kind="stable")]
        edges = np.flatnonzero(np.diff(self.take[pings], prepend=-1, append=-1))
        begin = 0
        while begin < len(pings):
            whole = edges[(edges > begin) & (edges <= begin + BATCH)]
            end = int(whole[-1]) if len(whole) else begin + BATCH
            yield pings[begin:end], np.unique(self.take[pings[begin:end]])
            begin = end


def _mean(value: Floats, index: Integers) -> Floats:
    return np.asarray(np.bincount(index, value) / np.maximum(np.bincount(index), 1))
