"""After the answer is opened: what somebody who knew it could have gained, and what the named baselines say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import Recording
from noise import IdealModel
from noise.discrepancy.baseline.emulate import Baseline, baseline_of
from noise.discrepancy.baseline.emulator import free_of
from noise.discrepancy.common.splits import Split
from noise.discrepancy.diagnosis import prepared
from noise.discrepancy.judge.steps import coarser_steps
from noise.discrepancy.name.explanation import conclude, intervals
from noise.discrepancy.name.search import Search
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit, log_likelihood, maximise
from noise.fitting.stack import NUISANCES, Stack
from training.proof.desk import serve
from training.proof.examine import RECORDED, SIMULATED
from training.proof.scoring.baselines import beam_nats, independent_name, process_nats, two_samples

STEPS = {"quantisation", "truncation"}
COMPARED = ("null", "effect", "matched", "confounded")  # kinds of trials that others are tried on as well
SEED = 0  # that the diagnosis runs with, so that both share their splits


@dataclass(frozen=True)
class Opened:
    """A trial laid open.

    Attributes:
        simulated, recorded: the two recordings.
        base: the law that stands for the simulation; `before` with nuisances fitted.
        split, search: as the diagnosis had them.
    """

    simulated: Recording
    recorded: Recording
    base: Baseline
    before: Fit
    split: Split
    search: Search

    @classmethod
    def of(cls, folder: Path) -> Opened:
        """Load a trial."""
        simulated, recorded = (Recording.load(folder / name) for name in (SIMULATED, RECORDED))
        base = baseline_of(IdealModel(), recorded, simulated, SEED)
        split = Split.of(base.with_twins(Batch.of(recorded)), np.random.default_rng([SEED, 1]))
        search, before = prepared(base, split, SEED)
        return cls(simulated, recorded, base, before, split, search)

    def on_vault(self, stack: Stack) -> float:
        """Return the log likelihood a ping on cells that nothing was fitted to, nats."""
        return float(log_likelihood(stack, self.split.vault).mean())


@dataclass(frozen=True)
class Best:
    """What somebody reaches who knows what to fit.

    Attributes:
        nats: gained across unseen open cells.
        vault: log likelihood a ping on the vault, nats.
        widths: of 90 % intervals by effect and parameter.
        least: of what each cause gains given the others, nats.
    """

    nats: float
    vault: float
    widths: dict[str, float]
    least: float = 0.0


def oracle(opened: Opened, truth: Sequence[Sequence[str]]) -> Best:
    """Return what fitting the true effects alone reaches; of each, the best of what names it rightly."""
    search = opened.search
    without = told = search.cross(search.base, [])
    stack, chosen = without.first.stack, list[str]()
    for names in truth:
        fits = {name: search.tried(stack, chosen, name).stack for name in names if name not in chosen}
        crossed = {name: search.cross(fit, [*chosen, name], near=told) for name, fit in fits.items()}
        if crossed:
            best = max(crossed, key=lambda name: crossed[name].nats.sum())
            stack, told, chosen = fits[best], crossed[best], [*chosen, best]
    final = conclude(search, told, chosen)
    known = intervals(final, search.both, opened.base.stack, opened.base.untied(search.both))
    widths = {f"{key[0]}.{key[1]}": i.high - i.low for key, i in known.items() if key[0] in chosen}
    gain = float((told.nats - without.nats).sum())
    each = [gain] if len(chosen) < 2 else [float(search.contribution(chosen, told, n)[0].sum()) for n in chosen]
    coarse = [_nats_of_steps(opened, final.stack) if STEPS & set(names) else 0.0 for names in truth]
    each = [nats + more for nats, more in zip_longest(each, coarse, fillvalue=0.0)]
    return Best(gain + sum(coarse), opened.on_vault(final.stack), widths, min(each))


def _nats_of_steps(opened: Opened, stack: Stack) -> float:
    """Return what knowing of a coarser register is worth, which no climb finds: a step has no slope."""
    own = opened.base.own
    found = None if own is None else coarser_steps(own.whole.resolution, opened.search.both, stack)
    return 0.0 if found is None else float(found[1].sum())


def flexible(opened: Opened) -> Best:
    """Return what a fit without causes reaches; its nats are the vault's, scaled to the open cells."""
    stack, both = opened.before.stack, opened.search.both
    free = (*free_of(stack), *NUISANCES)
    after = opened.on_vault(maximise(stack, tuple(dict.fromkeys(free)), both, 60).stack)
    return Best((after - opened.on_vault(stack)) * len(opened.split.both), after, {})


def assessed(question: dict[str, Any]) -> dict[str, Any]:
    """Return the scores of an opened trial.

    Args:
        question: `folder`, `answer`, `verdict`; `quick` leaves the baselines out.
    """
    answer, opened = question["answer"], Opened.of(Path(question["folder"]))
    truth = [cause["accepted"] for cause in answer["causes"]] if answer["kind"] != "stranger" else []
    before = opened.on_vault(opened.before.stack)
    apart = two_samples(opened.simulated, opened.recorded, np.random.default_rng([SEED, 20]))
    best = Best(0.0, before, {})
    if answer["kind"] != "null":
        best = oracle(opened, truth) if truth else flexible(opened)
    separation = max(best.nats, apart["classifier_nats"]) if answer["kind"] == "stranger" else best.nats
    scores: dict[str, Any] = {
        "separation_nats": separation,
        "least_nats": best.least,
        "vault_before": before,
        "vault_oracle": best.vault,
        **apart,
    }
    scores["oracle_widths"] = best.widths
    beside = answer["kind"] in COMPARED and not question.get("quick")
    return {**scores, **_baselines(opened)} if beside else scores


def _baselines(opened: Opened) -> dict[str, Any]:
    name, nats = independent_name(opened.search)
    return {
        "independent_name": name,
        "independent_nats": nats,
        "vault_process": process_nats(opened.before.stack, opened.search.both, opened.split.vault),
        "vault_beam": beam_nats(opened.recorded, opened.split),
    }


if __name__ == "__main__":
    serve(assessed)
