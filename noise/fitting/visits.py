"""Assignment of pings to conditions and visits, and the last echo before each ping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from acquisition import Ping, Recording
from acquisition.ping import RANGE_RATE

# mean number of consecutive pings of one condition from which a return to it is another visit; chosen here
MIN_BLOCK = 3.0
VISIT_PINGS = 25  # length of a visit where conditions never repeat (a moving robot); chosen here
MIN_VISITS = 8  # with fewer, no bootstrap over visits means anything, and each is cut into visits of `VISIT_PINGS`


def last_echo(recording: Recording) -> NDArray[np.float64]:
    """Return range and true distance of the last echo before each ping in its run, m, (n, 2); nan where none."""
    echo, run = recording.reading.echo, recording.run
    columns = {"range": recording.reading.range, "distance": recording.ping.distance}
    echoes = pd.DataFrame({name: np.where(echo, column, np.nan) for name, column in columns.items()})
    return echoes.groupby(run).ffill().groupby(run).shift().to_numpy()


def movement(recording: Recording) -> NDArray[np.float64]:
    """Return the change of the logged distance since the ping before in its run, m, (n,); 0 for the first."""
    change = pd.Series(recording.ping.distance).groupby(recording.run).diff().fillna(0.0)
    return np.asarray(change, dtype=np.float64)


def visits_of(recording: Recording) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return condition and visit (consecutive pings of one condition in one run) of each ping, (n,) each.

    Where single pings of several conditions alternate, all pings of one condition in one run are a visit. Where
    conditions hardly repeat or hardly change, each run is cut into visits of `VISIT_PINGS` pings instead.
    """
    n = len(recording)
    pair = np.unique(np.stack([recording.condition, recording.run], axis=1), axis=0, return_inverse=True)[1].ravel()
    pings_each = np.bincount(recording.condition)
    if is_moving(recording):
        visit = _consecutive(recording.run)
        return visit, visit
    block = np.cumsum(np.r_[False, np.diff(pair) != 0])
    visit = block if n >= MIN_BLOCK * (block[-1] + 1) else pair
    if len(np.unique(pair)) < MIN_VISITS:
        visit = np.unique(pair * (n + 1) + _consecutive(pair), return_inverse=True)[1]
    condition = recording.condition if len(pings_each) >= MIN_VISITS else visit
    return condition, visit


def is_moving(recording: Recording) -> bool:
    """Return whether conditions hardly ever repeat, as for a sensor on a moving robot."""
    n = len(recording)
    return bool(n > 2 * MIN_VISITS and n < 2.0 * (recording.condition.max() + 1))


def with_range_rate(recording: Recording) -> Ping:
    """Return the pings of a recording; those of a moving sensor with the rate of the logged distance, m/s."""
    ping = recording.ping
    if not (is_moving(recording) and recording.has("time_s")):
        return ping
    rate = np.zeros(len(ping))
    for run in np.unique(ping.run):
        rows = np.flatnonzero(ping.run == run)
        rows = rows[np.r_[True, np.diff(ping.time[rows]) > 0]]
        if len(rows) > 1:
            rate[rows] = np.gradient(ping.distance[rows], ping.time[rows])
    return replace(ping, covariates={**ping.covariates, RANGE_RATE: rate})


def _consecutive(group: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number series of at most `VISIT_PINGS` consecutive pings of each group, (n,)."""
    order = np.argsort(group, kind="stable")
    starts = np.r_[0, np.flatnonzero(np.diff(group[order])) + 1]
    rank = np.empty(len(group), dtype=np.int64)
    rank[order] = np.arange(len(group)) - np.repeat(starts, np.diff(np.r_[starts, len(group)]))
    return np.unique(group * (len(group) + 1) + rank // VISIT_PINGS, return_inverse=True)[1].ravel()
