"""Fit the decision model on labelled trials, and write its weights with a card and a reliability diagram."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from acquisition import SettingError
from acquisition.io.files import write_bytes, write_text
from acquisition.io.places import OutputFile, OutputFolder
from acquisition.limits import Count, Limit, Seed, Workers
from noise.discrepancy.judge.decision import WEIGHTS, DecisionModel
from training.common.canvas import AFTER, SOFT, Axes, panels
from training.common.commit import ROOT, commit
from training.diagnosis.generators.ensemble import FAMILIES, ODD, PAIR, SEVERAL, SINGLE, UNMODELLED
from training.diagnosis.judging.command import LEFT_OUT
from training.diagnosis.judging.decision_fit import (
    examples_of,
    fit,
    left_out_probabilities,
    quality,
)
from training.diagnosis.judging.record import Record
from training.diagnosis.judging.run import read, run
from training.diagnosis.judging.tasks import trials

KINDS = (SINGLE, PAIR, SEVERAL, UNMODELLED, ODD)  # whose true causes are known, and in which effects are selected


@dataclass(frozen=True)
class Args:
    """Fit the decision model.

    Attributes:
        out: folder of the records of the trials.
        n: number of trials of each family and kind; 0 fits to the records that exist.
        pings: approximate number in each recording.
        seed: of all random numbers; `sonar-gym judge` uses another.
        workers: number of processes.
        weights: file of the weights and the card.
        picture: file of the reliability diagram.
    """

    out: OutputFolder = Path("runs/decision")
    n: Annotated[int, Limit(0, 1_000_000)] = 20
    pings: Count = 2000
    seed: Seed = 1
    workers: Workers = 1
    weights: OutputFile = WEIGHTS
    picture: OutputFile = ROOT / "docs" / "images" / "decision-reliability.png"


def main(args: Args) -> None:
    """Run the trials, fit, and write."""
    version = commit()
    families = tuple(name for name in FAMILIES if name not in LEFT_OUT)
    tasks = trials(families, KINDS, args.n, args.seed, args.pings)
    records = run(tasks, args.out, args.workers) if args.n else read(args.out)
    model, card = fitted([r for r in records if r["family"] in families and r["kind"] in KINDS])
    # places of this machine are nobody else's
    command = f"sonar-gym fit-decision --n {args.n} --pings {args.pings} --seed {args.seed}"
    card |= {"command": command, "commit": version}
    write_text(args.weights, json.dumps({"model": model.to_dict(), "card": card}, indent=1) + "\n")
    write_bytes(args.picture, figure(card))
    print(json.dumps(card, indent=1))
    print(f"written: {args.weights} and {args.picture}")


def fitted(records: Sequence[Record]) -> tuple[DecisionModel, dict[str, object]]:
    """Return the model and its card.

    Raises:
        SettingError: too few trials.
    """
    done = [record for record in records if record["error"] is None]
    if not done:
        raise SettingError("no finished trials to fit the decision model to; give a number of trials with --n")
    examples = examples_of(done)
    model = fit(examples)
    scores = quality(left_out_probabilities(examples), examples)
    used = sorted({record["family"] for record in done})
    commits = sorted({record["commit"] for record in done})
    card: dict[str, object] = {
        "families used": used,
        "families left out": list(LEFT_OUT),
        "trials": len(done),
        "seeds": sorted({record["seed"] for record in done}),
        "diagnosed at": commits,
        "scores are of": "effects of each family by a model of the other families used",
    }
    return model, card | scores


def figure(card: Mapping[str, Any]) -> bytes:
    """Return the reliability diagram of a card as PNG: a point is as large as its number of effects.

    Bars are one binomial standard error; few trials have more than one effect.
    """
    table = card["reliability"]
    predicted, observed, n = (np.array([each[name] for each in table]) for name in ("predicted", "observed", "n"))
    error = np.sqrt(observed * (1.0 - observed) / n)

    def draw(axes: Axes) -> None:
        axes.plot([0, 1], [0, 1], color=SOFT, lw=1)
        axes.errorbar(predicted, observed, yerr=error, fmt="none", ecolor=AFTER, elinewidth=1)
        axes.scatter(predicted, observed, s=8 + 2 * n, color=AFTER, zorder=3)
        axes.set(
            xlim=(-0.03, 1.03),
            ylim=(-0.03, 1.03),
            xlabel="stated probability",
            ylabel="share of true causes, with one standard error",
        )
        axes.set_title("Families left out of the fit")

    return panels([draw], (4.6, 4.2))
