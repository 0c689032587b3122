"""Rows of the table of targets: each is computed from the records of one family or of several."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, kstest

from noise.metrics import reliability
from training.diagnosis.generators.ensemble import PAIR, SAME, SIMULATOR, SINGLE, UNMODELLED
from training.diagnosis.judging.record import Record
from training.diagnosis.judging.scoring import (
    aspect_right,
    covered,
    gap_closed,
    gap_unseen,
    is_apart,
    is_strong,
    leads,
    made_worse,
    misled,
    names_all,
    no_wrong_share,
    region_overlap,
    statements,
)

N_BOOTSTRAP = 1000
USUAL_PINGS = 2000  # to which times of longer recordings are scaled
SIZE = 0.05  # level at which the size of the test is checked
MODELS = (("model", "corrected"), ("readings", "own"))  # what is corrected -> its score
NAMED = ("explained", "partly_explained")
Records = Sequence[Record]


@dataclass(frozen=True)
class Row:
    """One measured figure beside its target.

    Attributes:
        metric: what is measured.
        target: bounds of the target, (low, high), each end included; infinite where open.
        value, low, high: figure with its 95 % interval; NaN where there is none.
        n: number of trials or statements.
        without: number of trials that have no such figure, as where there is no gap to close.
        percent: whether the figure is a share.
    """

    metric: str
    target: tuple[float, float]
    value: float
    low: float
    high: float
    n: int
    percent: bool = True
    without: int = 0

    @property
    def count(self) -> str:
        """Number of values; "a/b" where only a of b trials have one."""
        return f"{self.n:,}/{self.n + self.without:,}" if self.without else f"{self.n:,}"

    @property
    def hit(self) -> bool | None:
        """Whether the figure meets its target; None where nothing was measured or no target is stated."""
        if not self.n or not np.isfinite(self.value) or self.target == FREE:
            return None
        return self.target[0] <= self.value <= self.target[1]

    def number(self, value: float) -> str:
        """Return a value in the unit of the row; a share below 1 % that is not 0 with one digit."""
        if not np.isfinite(value):
            return "–"
        if not self.percent:
            return f"{value:.3g}"
        return f"{100 * value:.1f} %" if 0.0 < value < 0.01 else f"{100 * value:.0f} %"

    @property
    def aim(self) -> str:
        """The target in words."""
        low, high = self.target
        if self.target == FREE:
            return "none stated"
        if np.isfinite(low) and np.isfinite(high):
            return f"{self.number(low)} to {self.number(high)}"
        return f"≥ {self.number(low)}" if np.isfinite(low) else f"≤ {self.number(high)}"


FREE = (-np.inf, np.inf)


def at_least(value: float) -> tuple[float, float]:
    """Return the target of a figure that must not be smaller."""
    return value, np.inf


def at_most(value: float) -> tuple[float, float]:
    """Return the target of a figure that must not be greater."""
    return -np.inf, value


def share(metric: str, target: tuple[float, float], outcomes: Iterable[bool | None]) -> Row:
    """Return a share with its Wilson interval (Wilson 1927)."""
    every = list(outcomes)
    outcome = np.array([each for each in every if each is not None], dtype=bool)
    without = len(every) - len(outcome)
    if not len(outcome):
        return Row(metric, target, np.nan, np.nan, np.nan, 0, without=without)
    interval = binomtest(int(outcome.sum()), len(outcome)).proportion_ci(method="wilson")
    low, high = float(interval.low), float(interval.high)
    return Row(metric, target, float(outcome.mean()), low, high, len(outcome), without=without)


def statistic(
    metric: str,
    target: tuple[float, float],
    values: Iterable[float | None],
    of: Callable[[np.ndarray], float],
    percent: bool = False,
) -> Row:
    """Return a statistic with its bootstrap interval."""
    every = list(values)
    value = np.array([each for each in every if each is not None], dtype=np.float64)
    without = len(every) - len(value)
    if not len(value):
        return Row(metric, target, np.nan, np.nan, np.nan, 0, percent, without)
    rng = np.random.default_rng(0)  # the table of the same records is the same
    draws = [of(rng.choice(value, len(value))) for _ in range(N_BOOTSTRAP)]
    low, high = np.quantile(draws, [0.025, 0.975])
    return Row(metric, target, float(of(value)), float(low), float(high), len(value), percent, without)


def rows(records: Records) -> list[Row]:
    """Return all rows; a record with an error counts as a failure of its own row and nowhere else."""
    done = [record for record in records if record["error"] is None]
    failed = share("diagnosis ended in an error", at_most(0.0), (r["error"] is not None for r in records))
    parts = (_nulls, _places, _names, _probabilities, _corrections, _near_corrections, _times)
    return [failed, *(row for part in parts for row in part(done))]


def of_kind(records: Records, *kinds: str) -> list[Record]:
    """Return the records of some kinds."""
    return [record for record in records if record["kind"] in kinds]


def _nulls(records: Records) -> Iterator[Row]:
    null = of_kind(records, SAME)
    verdicts = [record["verdict"]["verdict"] for record in null]
    p = [record["verdict"]["p_value"] for record in null]
    yield share("same sonar twice: verdict other than none", at_most(0.05), (v != "none" for v in verdicts))
    yield share("same sonar twice: a cause named", at_most(0.02), (v in NAMED for v in verdicts))
    yield share("same sonar twice: p < 5 %", (0.03, 0.07), (each < SIZE for each in p))
    uniform = float(kstest(p, "uniform").pvalue) if p else np.nan
    yield Row("same sonar twice: p-values uniform (KS p)", at_least(0.01), uniform, np.nan, np.nan, len(p), False)


def _places(records: Records) -> Iterator[Row]:
    strong = [record for record in of_kind(records, SINGLE) if is_strong(record)]
    yield share("strong single: aspect right", at_least(0.9), map(aspect_right, strong))
    for name, bounded in (("within a region", True), ("everywhere", False)):
        some = [r for r in strong if bool(r["causes"][0]["region"]) == bounded]
        yield statistic(f"strong single, acts {name}: IoU", at_least(0.6), map(region_overlap, some), np.mean)


def _names(records: Records) -> Iterator[Row]:
    single, pair = of_kind(records, SINGLE), [r for r in of_kind(records, PAIR) if is_strong(r)]
    strong = [record for record in single if is_strong(record)]
    apart = [record for record in single if is_apart(record)]
    yield share("strong single: true cause most probable", at_least(0.95), map(leads, strong))
    yield share("single, 15 nats apart in CRPS: true cause most probable", at_least(0.95), map(leads, apart))
    yield share("strong single: no wrong cause > 10 %", at_least(0.9), map(no_wrong_share, strong))
    yield share("strong pair: both named", at_least(0.8), map(names_all, pair))
    unmodelled = of_kind(records, UNMODELLED)
    yield share("unmodelled: no wrong cause believed", at_least(0.95), (not misled(r) for r in unmodelled))


def _probabilities(records: Records) -> Iterator[Row]:
    known = of_kind(records, SAME, SINGLE, PAIR, UNMODELLED)
    pairs = np.array([pair for record in known for pair in statements(record)]).reshape(-1, 2)
    group = np.array([k for k, record in enumerate(known) for _ in statements(record)])
    error = reliability(pairs[:, 0], pairs[:, 1] > 0, group).gap if len(pairs) else np.nan
    yield Row("stated probabilities: calibration error", at_most(0.05), error, np.nan, np.nan, len(pairs), False)
    yield share("90 % intervals cover", (0.87, 0.93), (hit for record in known for hit in covered(record)))


def _corrections(records: Records) -> Iterator[Row]:
    named = of_kind(records, SINGLE, PAIR)
    unseen = [gap_unseen(record) for record in named if is_strong(record)]
    yield from _gaps("unseen visits, strong", unseen, 0.95, 0.7)
    causes_only = [gap_closed(record, "causes_only") for record in named]
    yield statistic("fresh recording, causes without empirical term: median gap", FREE, causes_only, np.median)
    other, simulator = of_kind(records, UNMODELLED), of_kind(records, SIMULATOR)
    for of, model in MODELS:
        plain, fresh = f"fresh recording, corrected {of}", [gap_closed(record, model) for record in named]
        yield from _gaps(f"{plain}, known causes", fresh, 0.9, 0.7)
        below = (None if gap is None else gap < 0 for gap in fresh)
        yield share(f"{plain}, known causes: gap closed below 0", at_most(0.0), below)
        unknown, others = ([gap_closed(record, model) for record in some] for some in (other, simulator))
        yield statistic(f"{plain}, unmodelled: median gap closed", at_least(0.6), unknown, np.median)
        yield statistic(f"{plain}, other simulator: median gap closed", at_least(0.9), others, np.median)
        worse = (made_worse(record, model) for record in records)
        yield share(f"{plain}: worse than the simulation", at_most(0.0), worse)


def _near_corrections(records: Records) -> Iterator[Row]:
    named, other = of_kind(records, SINGLE, PAIR), of_kind(records, UNMODELLED)
    for of, model in MODELS:
        near = f"{of} within 10 %"
        yield from _gaps(f"{near}, known causes", [gap_closed(r, model, near=True) for r in named], 0.9, 0.7)
        unknown = [gap_closed(record, model, near=True) for record in other]
        yield statistic(f"{near}, unmodelled: median gap closed", at_least(0.6), unknown, np.median)
        worse = (made_worse(record, model, near=True) for record in records)
        yield share(f"{near}: worse than the simulation", at_most(0.0), worse)


def _gaps(name: str, values: list[float | None], median: float, tenth: float) -> Iterator[Row]:
    yield statistic(f"{name}: median gap closed", at_least(median), values, np.median)
    yield statistic(f"{name}: tenth percentile", at_least(tenth), values, lambda v: float(np.quantile(v, 0.1)))


def _times(records: Records) -> Iterator[Row]:
    seconds = [record["seconds"] * USUAL_PINGS / max(record["n"], USUAL_PINGS) for record in records]
    yield statistic("seconds for 2,000 pings, median", at_most(5.0), seconds, np.median)
