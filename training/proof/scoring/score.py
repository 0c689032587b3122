"""The whole table of targets, from a ledger's opened trials, with confidence limits; and what stands beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import binomtest, kstwo

from noise.discrepancy.judge.verdict import CLAIMS
from training.proof.seal import OPENED, VERDICT

CLEAR, FAINT = 15.0, 2.0  # nats
ENOUGH_TRIALS = 20  # for a target to be met; fewer may still miss it; ours
TELLABLE = ("effect", "pair", "matched", "confounded")  # kinds that a measurement in the trial's world can tell
LEAST_NATS_A_PING = 0.002  # an oracle that gains less on the vault leaves no gap to close
BINS = (-np.inf, 2.0, 5.0, 15.0, 50.0, 150.0, np.inf)


@dataclass(frozen=True)
class Scored:
    """A trial with everything known of it.

    Attributes:
        answer, verdict, scores: as the ledger has them.
        seconds: the diagnosis took.
    """

    answer: dict[str, Any]
    verdict: dict[str, Any]
    scores: dict[str, Any]
    seconds: float

    @property
    def kind(self) -> str:
        """Null, effect, pair, stranger, matched, confounded or family."""
        return str(self.answer["kind"])

    @property
    def nats(self) -> float:
        """How far the truth is from nothing: what an oracle gains on unseen cells; of a pair, by the weaker of both."""
        return float(self.scores["least_nats" if self.kind == "pair" else "separation_nats"])

    @property
    def said(self) -> str:
        """The kind of verdict."""
        return str(self.verdict["verdict"])

    @property
    def claimed(self) -> list[set[str]]:
        """For each effect that is claimed, it and what it may be mistaken for."""
        if self.said not in CLAIMS:
            return []
        return [{e["effect"], *e["indistinguishable_from"]} for e in self.verdict["effects"]]

    def holds(self, cause: dict[str, Any]) -> bool:
        """Tell whether a cause is in what is claimed."""
        return any(set(cause["accepted"]) & each for each in self.claimed)

    @property
    def right(self) -> bool:
        """Whether every cause is in what is claimed; of a stranger, whether it is said to be unknown."""
        if self.kind == "null":
            return self.said == "none"
        if self.kind == "stranger":
            return self.said == "unknown"
        return all(self.holds(cause) for cause in self.answer["causes"])

    @property
    def alone(self) -> bool:
        """Whether one effect is named, and nothing is said to be as likely."""
        return self.said == "named" and len(self.claimed) == 1 and len(self.claimed[0]) == 1

    @property
    def closed(self) -> float:
        """The share of the vault's gap between simulation and oracle that is closed; nan where there is none."""
        return self._share_of_gap(self.verdict["held_out"]["after"]["log_likelihood_per_ping"])

    def closed_by(self, score: str) -> float:
        """Return the same of another method, by the name of its score."""
        return self._share_of_gap(self.scores[score])

    def _share_of_gap(self, after: float) -> float:
        gap = self.scores["vault_oracle"] - self.scores["vault_before"]
        return float((after - self.scores["vault_before"]) / gap) if gap > LEAST_NATS_A_PING else np.nan


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Attributes:
        metric, target: in words.
        value: what was measured; low and high its 95 % limits, nan where they say nothing.
        trials: it rests on.
        met: whether the target is met; None where too few trials tell.
    """

    metric: str
    target: str
    value: float
    low: float
    high: float
    trials: int
    met: bool | None


def trials_of(lines: Iterable[dict[str, Any]]) -> list[Scored]:
    """Return the opened trials of a ledger."""
    lines = list(lines)
    verdicts = {line["trial"]: line for line in lines if line["event"] == VERDICT}
    out = []
    for line in lines:
        if line["event"] == OPENED:
            judged = verdicts[line["trial"]]
            out.append(Scored(line["answer"], judged["verdict"], line["scores"], float(judged["seconds"])))
    return out


def share(metric: str, target: str, hits: Sequence[bool], good: Callable[[float], bool]) -> Line:
    """Return a line of a share, with Wilson's limits."""
    n, k = len(hits), int(np.sum(hits))
    if n == 0:
        return Line(metric, target, np.nan, np.nan, np.nan, 0, None)
    limits = binomtest(k, n).proportion_ci(0.95, "wilson")
    return Line(metric, target, k / n, float(limits.low), float(limits.high), n, good(k / n))


def quantile(metric: str, target: str, value: Sequence[float], q: float, least: float) -> Line:
    """Return a line of a quantile, with limits from the order of the sample."""
    known = np.sort(np.array([v for v in value if np.isfinite(v)]))
    n = len(known)
    if n == 0:
        return Line(metric, target, np.nan, np.nan, np.nan, 0, None)
    spread = 1.96 * np.sqrt(n * q * (1.0 - q))
    low, high = (known[int(np.clip(round(n * q + s), 0, n - 1))] for s in (-spread, spread))
    middle = float(np.quantile(known, q))
    return Line(metric, target, middle, float(low), float(high), n, middle >= least)


def at_least(limit: float) -> Callable[[float], bool]:
    """Return whether a value reaches a limit."""
    return lambda value: value >= limit


def at_most(limit: float) -> Callable[[float], bool]:
    """Return whether a value keeps below a limit."""
    return lambda value: value <= limit


def table(trials: Sequence[Scored]) -> list[Line]:
    """Return the design's table of targets, but for next measurements (`training.proof.scoring.settled`)."""
    return judged(_lines(trials))


def judged(lines: Sequence[Line]) -> list[Line]:
    """Return lines of which one counts as met by enough trials only."""
    return [replace(line, met=None) if line.met and line.trials < ENOUGH_TRIALS else line for line in lines]


def _lines(trials: Sequence[Scored]) -> list[Line]:
    null = [t for t in trials if t.kind == "null"]
    single = [t for t in trials if t.kind in ("effect", "matched", "confounded", "family")]
    clear = [t for t in single if t.nats >= CLEAR]
    faint = [t for t in single if t.nats < FAINT]
    pairs = [t for t in trials if t.kind == "pair" and t.nats >= CLEAR]
    strange = [t for t in trials if t.kind == "stranger" and t.nats >= CLEAR]
    return [
        share("null: an effect named", "≤ 2 %", [t.said in CLAIMS for t in null], at_most(0.02)),
        share("null: located, family-wise", "≤ 5 %", [p <= 0.05 for p in scan_p(null)], at_most(0.05)),
        _uniform(null),
        share("aspect right, ≥ 15 nats", "≥ 90 %", [aspect_right(t) for t in clear if _aspects(t)], at_least(0.9)),
        quantile("overlap of the region (IoU), median", "≥ 0.6", [overlap(t) for t in clear], 0.5, 0.6),
        share("right class, ≥ 15 nats", "≥ 95 %", [t.right for t in clear], at_least(0.95)),
        share("pairs, both named, ≥ 15 nats each", "≥ 80 %", [t.right for t in pairs], at_least(0.8)),
        share("< 2 nats: the set holds the truth", "≥ 90 %", [_not_wrong(t) for t in faint], at_least(0.9)),
        share("< 2 nats: a lone name", "≤ 5 %", [t.alone for t in faint], at_most(0.05)),
        share("stranger, ≥ 15 nats: unknown", "≥ 90 %", [t.said == "unknown" for t in strange], at_least(0.9)),
        share("stranger, ≥ 15 nats: a wrong name", "≤ 5 %", [t.said in CLAIMS for t in strange], at_most(0.05)),
        share("false unknown on catalogue effects", "≤ 10 %", [t.said == "unknown" for t in single], at_most(0.1)),
        share("90 % intervals cover", "87–93 %", covered(clear), lambda v: 0.87 <= v <= 0.93),
        _widths(clear),
        quantile("vault gap closed, median", "≥ 0.9", [t.closed for t in clear], 0.5, 0.9),
        quantile("vault gap closed, tenth percentile", "≥ 0.7", [t.closed for t in clear], 0.1, 0.7),
        quantile("vault gap closed, strangers, median", "≥ 0.6", [t.closed for t in strange], 0.5, 0.6),
        _seconds(trials),
    ]


def scan_p(trials: Sequence[Scored]) -> list[float]:
    """Return the p-values of the scans of null trials that named nothing: the verdict's counts two ways of looking."""
    return [t.verdict["p_value"] / 2.0 for t in trials if t.said not in CLAIMS]


def _uniform(null: Sequence[Scored]) -> Line:
    """Test the scans' p-values for uniformity below one half, where the verdict still tells them apart."""
    p = np.sort(scan_p(null))
    n = len(p)
    if n < 5:
        return Line("null: p-values uniform (KS p)", "> 0.01", np.nan, np.nan, np.nan, n, None)
    below = p[p < 0.5]
    rank = np.arange(1, len(below) + 1)
    gap = max(np.max(rank / n - below, initial=0.0), np.max(below - (rank - 1) / n, initial=0.0))
    value = float(kstwo.sf(max(gap, abs(len(below) / n - 0.5)), n))
    return Line("null: p-values uniform (KS p)", "> 0.01", value, np.nan, np.nan, n, value > 0.01)


def _aspects(trial: Scored) -> list[str]:
    return list(trial.answer["causes"][0].get("aspects", []))


def aspect_right(trial: Scored) -> bool:
    """Tell whether the first thing located is of an aspect that the cause has."""
    where = trial.verdict["where"]
    return bool(where) and where[0]["aspect"] in _aspects(trial)


def overlap(trial: Scored) -> float:
    """Return the overlap of the first located region with the true one, in the true one's column; nan without one."""
    region = trial.answer["causes"][0].get("region")
    if not region:
        return np.nan
    (column, (low, high)), *_ = region.items()
    found = [f["region"][column] for f in trial.verdict["where"] if column in f["region"]]
    if not found:
        return 0.0
    a, b = found[0]
    both = max(0.0, min(b, high) - max(a, low))
    return float(both / (max(b, high) - min(a, low)))


def _not_wrong(trial: Scored) -> bool:
    """Tell whether the truth is among what is not excluded: nothing is, where nothing is claimed."""
    return trial.said not in CLAIMS or trial.right


def covered(trials: Sequence[Scored]) -> list[bool]:
    """Return for each known parameter that was estimated whether its interval holds the truth."""
    out = []
    for trial in trials:
        for cause in trial.answer["causes"]:
            for effect in trial.verdict["effects"] if trial.said in CLAIMS else []:
                told = effect["parameters"].get(cause.get("parameter"))
                if effect["effect"] == cause["name"] and told is not None:
                    out.append(bool(told["low"] <= cause["value"] <= told["high"]))
    return out


def _widths(trials: Sequence[Scored]) -> Line:
    """Return the median width of intervals against the oracle's."""
    ratio = []
    for trial in trials:
        for effect in trial.verdict["effects"]:
            for name, told in effect["parameters"].items():
                best = trial.scores["oracle_widths"].get(f"{effect['effect']}.{name}", 0.0)
                if best > 0:
                    ratio.append((told["high"] - told["low"]) / best)
    line = quantile("width of intervals against the oracle's, median", "≤ 1.3", ratio, 0.5, 0.0)
    return replace(line, met=line.value <= 1.3 if line.trials else None)


def _seconds(trials: Sequence[Scored]) -> Line:
    line = quantile("seconds a diagnosis, median", "≤ 60", [t.seconds for t in trials], 0.5, 0.0)
    return replace(line, met=line.value <= 60.0 if line.trials else None)


@dataclass(frozen=True)
class Band:
    """Trials of about the same separation.

    Attributes:
        low, high: of the oracle's nats.
        trials: number.
        answered, right: shares of them.
        good: share of those answered that are right; nan where none was.
    """

    low: float
    high: float
    trials: int
    answered: float
    right: float
    good: float

    @property
    def words(self) -> str:
        """The range of nats in words."""
        if np.isfinite(self.low) and np.isfinite(self.high):
            return f"{self.low:g} to {self.high:g}"
        return f"< {self.high:g}" if np.isfinite(self.high) else f"≥ {self.low:g}"


def by_separation(trials: Sequence[Scored]) -> list[Band]:
    """Return how trials with a cause of the catalogue came out, by separation."""
    single = [t for t in trials if t.kind in ("effect", "matched", "confounded", "pair", "family")]
    bands = ((low, high, [t for t in single if low <= t.nats < high]) for low, high in pairwise(BINS))
    return [_band(low, high, here) for low, high, here in bands if here]


def _band(low: float, high: float, trials: Sequence[Scored]) -> Band:
    answered = [t.right for t in trials if t.said in CLAIMS]
    good = float(np.mean(answered)) if answered else np.nan
    return Band(low, high, len(trials), len(answered) / len(trials), float(np.mean([t.right for t in trials])), good)


def confusion(trials: Sequence[Scored]) -> dict[str, dict[str, int]]:
    """Return by true cause how often what was said: the first effect claimed, or none or unknown."""
    out: dict[str, dict[str, int]] = {}
    for trial in trials:
        truth = " + ".join(cause["name"] for cause in trial.answer["causes"]) or "nothing"
        told = trial.verdict["effects"][0]["effect"] if trial.said in CLAIMS else trial.said
        row = out.setdefault(truth if trial.kind != "pair" else "a pair", {})
        row[told] = row.get(told, 0) + 1
    return out
