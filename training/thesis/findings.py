"""What a comparison of the thesis's networks found: means over seeds, ranks, and each of the thesis's claims tested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.stats import kendalltau, rankdata, spearmanr, t

from training.thesis.credence import MIRROR, RUBBER, SHORT_M, Surfaces
from training.thesis.data import Floats, Samples
from training.thesis.fit import Fitted
from training.thesis.numbers import LSTM_TIMES_AS_LONG, TABLES
from training.thesis.optimisers import OPTIMISERS, OptimiserName
from training.thesis.runs import Comparison, Job

Verdict = Literal["agrees", "contrary", "undecided"]


@dataclass(frozen=True)
class Mean:
    """A mean over seeds with half the width of its 95 % interval (Student's t); 0 where there is one seed."""

    value: float
    half: float

    @classmethod
    def of(cls, values: Sequence[float] | Floats) -> Mean:
        """Return the mean of one number a seed."""
        n = len(values)
        half = float(t.ppf(0.975, n - 1) * np.std(values, ddof=1) / np.sqrt(n)) if n > 1 else 0.0
        return cls(float(np.mean(values)), half)

    def __str__(self) -> str:
        return f"{self.value:.4f} ± {self.half:.4f}"

    def verdict(self) -> Verdict:
        """Return whether the mean is surely above zero, surely below, or neither; one seed decides nothing."""
        if self.half == 0.0 or not abs(self.value) > self.half:
            return "undecided"
        return "agrees" if self.value > 0.0 else "contrary"


@dataclass(frozen=True)
class Claim:
    """Something that the thesis says, and what was found."""

    thesis: str
    here: str
    verdict: Verdict


@dataclass(frozen=True, eq=False)
class Findings:
    """All networks of a comparison, trained.

    Attributes:
        comparison: which they are.
        fitted: what training each gave.
        samples: all pings.
    """

    comparison: Comparison
    fitted: dict[Job, Fitted]
    samples: Samples

    def final(self, jobs: list[Job], what: Literal["train", "validation", "seconds"] = "validation") -> Floats:
        """Return a number after the last pass of each network, (seeds,)."""
        return np.array([getattr(self.fitted[job], what)[-1] for job in jobs])

    def curves(self, jobs: list[Job], what: Literal["train", "validation"]) -> Floats:
        """Return the losses after each pass, (seeds, passes); an early stop's last one stays."""
        passes, losses = jobs[0].recipe.epochs, [getattr(self.fitted[job], what) for job in jobs]
        return np.array([np.pad(one, (0, passes - len(one)), mode="edge") for one in losses])

    def losses(self, hidden: int) -> Floats:
        """Return the last validation losses of a table, (optimisers, seeds)."""
        return np.array([self.final(self.comparison.table(hidden, name)) for name in OPTIMISERS])

    def ranks(self, hidden: int) -> dict[OptimiserName, int]:
        """Return the place of each optimiser in a table, 1 for the least validation loss."""
        order = rankdata(self.losses(hidden).mean(axis=1), method="ordinal")
        return {name: int(place) for name, place in zip(OPTIMISERS, order, strict=True)}

    def agreement(self, hidden: int) -> tuple[float, float, Floats]:
        """Return Spearman's and Kendall's correlation with the thesis's table, and Spearman's of each seed alone."""
        printed = np.array([TABLES[hidden][name].validation for name in OPTIMISERS])
        losses = self.losses(hidden)
        rho, tau = spearmanr(printed, losses.mean(axis=1))[0], kendalltau(printed, losses.mean(axis=1))[0]
        return float(rho), float(tau), np.array([spearmanr(printed, seed)[0] for seed in losses.T])

    @cached_property
    def surfaces(self) -> Surfaces:
        """Credence of the readings, and of what the networks of figures 4.5 to 5.1 map them to."""
        pairs = {"MLP": self.comparison.mlp, "LSTM": self.comparison.lstm}
        weights = {k: (jobs[0].network, [self.fitted[job].theta for job in jobs]) for k, jobs in pairs.items()}
        return Surfaces(self.samples, weights)

    def claims(self) -> list[Claim]:
        """Return what the thesis says of its networks, each with what was found here."""
        return [*self._ranking(), *self._sizes(), self._first_pass(), *self._lstm(), self._batches(), *self._mapping()]

    def _ranking(self) -> list[Claim]:
        return [self._ends_lower(better, worse) for better, worse in PAIRS]

    def _ends_lower(self, better: OptimiserName, worse: OptimiserName) -> Claim:
        table, final = self.comparison.table, self.final
        gaps = [final(table(hidden, worse)) - final(table(hidden, better)) for hidden in self.comparison.sizes]
        mean = Mean.of(np.mean(gaps, axis=0))
        thesis = f"{OPTIMISERS[better].title} ends lower than {OPTIMISERS[worse].title}"
        return Claim(thesis, f"by {mean}, mean over sizes", mean.verdict())

    def _sizes(self) -> list[Claim]:
        tables = [self.final(self.comparison.table(hidden, "nadam")) for hidden in self.comparison.sizes]
        if len(tables) < 2:
            return []
        mean, least, most = Mean.of(tables[0] - tables[-1]), self.comparison.sizes[0], self.comparison.sizes[-1]
        return [Claim(f"{most} neurons end lower than {least} (Nadam)", f"by {mean}", mean.verdict())]

    def _first_pass(self) -> Claim:
        hidden = self.comparison.sizes[-1]
        first = {name: self.curves(self.comparison.table(hidden, name), "validation")[:, 0] for name in OPTIMISERS}
        rival = min((name for name in first if name != "nadam"), key=lambda name: float(first[name].mean()))
        mean = Mean.of(first[rival] - first["nadam"])
        here = f"lower than the next, {OPTIMISERS[rival].title}, by {mean} ({hidden} neurons)"
        return Claim("after the first pass Nadam is lowest", here, mean.verdict())

    def _lstm(self) -> list[Claim]:
        mlp, lstm = self.comparison.mlp, self.comparison.lstm
        mean = Mean.of(self.final(mlp) - self.final(lstm))
        times = float(np.median(self.final(lstm, "seconds") / self.final(mlp, "seconds")))
        slower = f"{times:.1f} times as long; each is compiled for its own shape"
        verdict: Verdict = "agrees" if 2 / 3 < times / LSTM_TIMES_AS_LONG < 1.5 else "contrary"
        return [
            Claim("the LSTM ends lower than the MLP of as many units", f"by {mean}", mean.verdict()),
            Claim("the LSTM takes almost 5 times as long as the MLP", slower, verdict),
        ]

    def _batches(self) -> Claim:
        """Compare Keras's own steps alone: mini-batches at other rates are another question, told in the table."""
        variants = self.comparison.variants
        gap = {k: self.final(v) - self.final(variants["as the tables"]) for k, v in variants.items() if "mini" in k}
        mean = Mean.of(np.min(list(gap.values()), axis=0))
        return Claim(
            "mini-batches are no better than online", f"the better of them ends higher by {mean}", mean.verdict()
        )

    def _mapping(self) -> list[Claim]:
        surfaces = self.surfaces
        mirror, rubber, near = surfaces.of(MIRROR), surfaces.of(RUBBER), surfaces.distance < SHORT_M
        gaps = [surfaces.mean(name, mirror) - surfaces.mean(name, rubber) for name in surfaces.networks]
        better = Mean.of(np.min(gaps, axis=0))
        short = Mean.of(surfaces.mean("LSTM", mirror & near) - surfaces.mean("MLP", mirror & near))
        return [
            Claim(
                "both networks map the mirror better", f"mapped credence higher by {better} at least", better.verdict()
            ),
            Claim(
                "at short range the LSTM maps the mirror better", f"mapped credence higher by {short}", short.verdict()
            ),
        ]


# neighbours in the order of all three tables of the thesis
PAIRS: tuple[tuple[OptimiserName, OptimiserName], ...] = (
    ("nadam", "adam"),
    ("adam", "rmsprop"),
    ("rmsprop", "adadelta"),
    ("adadelta", "sgd"),
    ("sgd", "adagrad"),
)
