"""Cross-talk of sonars side by side in the rig: how many, in which order, at which interval.

    python -m benchmarks.crosstalk

Sonars 50 mm apart face the thesis's mirror. The first is read; the others' bursts reach it by way of the reflector.
They fire at once, in turn, or each by a clock of its own. Prints Markdown for docs/explanation/cross-talk.md and writes
docs/images/cross-talk.png with its record.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from acquisition import Ping
from acquisition.bench import Neighbour, Rig, Setup, Unit
from acquisition.io.files import write_bytes
from noise.law import CREDENCE_TOLERANCE
from noise.metrics import ClusterMean
from training.common.canvas import AFTER, BEFORE, INK, Axes, panels
from training.common.commit import commit
from training.common.records import write_record
from training.common.tables import markdown_table

GAP_M, QUIET_DB = 0.05, -300.0  # between sonars; their housings block the direct path
UNITS, PINGS = range(801, 809), 12  # serial numbers, and pings at each distance
DISTANCES_M = (0.4, 0.8, 1.5, 2.2, 3.0, 4.0)
COUNTS, INTERVALS_S = (2, 4, 8), (0.04, 0.065, 0.1, 0.2)
CLOCK_STEP = 0.013  # relative difference of the clocks of neighbouring sonars that fire by themselves
ORDERS = ("at once", "in turn", "own clocks")
COLOURS = dict(zip(ORDERS, (BEFORE, AFTER, INK), strict=True))
IMAGE = Path("docs/images/cross-talk.png")


def others(order: str, count: int, interval_s: float) -> tuple[float, tuple[Neighbour, ...]]:
    """Return the time between pings of the first sonar, s, and the other sonars.

    Args:
        order: in which they fire.
        count: number of sonars, the first one included.
        interval_s: between the bursts of one sonar, or of one and the next where they fire in turn.
    """
    period = count * interval_s if order == "in turn" else interval_s
    found = []
    for k in range(1, count):
        own = {"at once": (0.0, period), "in turn": (k * interval_s, period)}.get(order)
        first, every = own or (0.37 * k * interval_s, interval_s * (1.0 + CLOCK_STEP * k))
        found.append(Neighbour(every, first, strength_db=QUIET_DB, beside_m=GAP_M * k))
    return period, tuple(found)


def wrong(order: str, count: int, interval_s: float) -> ClusterMean:
    """Return the share of echoes that are not within 10 % of the distance, over units."""
    period, neighbours = others(order, count, interval_s)
    setup = Setup(gain=31, neighbour=neighbours)
    distance = np.repeat(DISTANCES_M, PINGS)
    time = np.repeat(np.arange(len(DISTANCES_M)) * 600, PINGS) + np.tile(np.arange(PINGS), len(DISTANCES_M))
    ping = Ping.of(distance, reflectance=0.9, time=period * time, run=np.repeat(np.arange(len(DISTANCES_M)), PINGS))
    shares = []
    for serial in UNITS:
        reading = Rig(Unit.draw(serial), replace(setup)).ping(ping, np.random.default_rng(serial)).reading(setup)
        off = np.abs(reading.range - distance) > CREDENCE_TOLERANCE * distance
        shares.append(off[reading.echo])
    unit = np.repeat(np.arange(len(shares)), [len(share) for share in shares])
    return ClusterMean.of(np.concatenate(shares), unit)


def figure(record: dict[str, dict[str, list[list[float]]]]) -> bytes:
    """Return the share of wrong echoes over the interval, one panel for each number of sonars, as PNG.

    Args:
        record: percent and half width of its interval at each interval, by number of sonars and order.
    """

    def draw(count: str, axes: Axes) -> None:
        for order in ORDERS:
            share, error = np.transpose(record[count][order])
            axes.errorbar(1e3 * np.array(INTERVALS_S), share, error, color=COLOURS[order], marker="o", label=order)
        axes.set(title=f"{count} sonars", xlabel="interval (ms)", ylim=(-2, 100))
        if count == next(iter(record)):
            axes.set_ylabel("wrong echoes (%)")
            axes.legend()

    return panels([partial(draw, count) for count in record], (8.0, 3.2), share_y=True)


def main() -> None:
    """Measure all combinations, print the table, write the record and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, default=IMAGE)
    options, made_by = parser.parse_args(), commit()
    found = {
        str(count): {order: [wrong(order, count, interval) for interval in INTERVALS_S] for order in ORDERS}
        for count in COUNTS
    }
    alone = wrong("at once", 1, INTERVALS_S[-1])
    header = ("order", "sonars", *(f"{1e3 * interval:.0f} ms" for interval in INTERVALS_S))
    rows = [(order, n, *map(_percent, each[order])) for order in ORDERS for n, each in found.items()]
    print(f"alone: {_percent(alone)} %\n\n{markdown_table(header, rows)}")
    plain = {
        n: {order: [(100.0 * one.mean, 196.0 * one.error) for one in some] for order, some in each.items()}
        for n, each in found.items()
    }
    record = write_record(options.figure, made_by, "python -m benchmarks.crosstalk", plain)
    write_bytes(options.figure, figure(record))


def _percent(share: ClusterMean) -> str:
    return f"{100.0 * share.mean:.1f} ± {196.0 * share.error:.1f}"


if __name__ == "__main__":
    main()
