"""Write the page on noise models: all side by side, what memory is worth, how far credence can be trusted."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray

from acquisition import Recording
from acquisition.files import write_bytes, write_text
from noise import CredenceTable, SonarModel, follow, load_model
from noise.credence import wilson
from noise.law import Floats
from noise.metrics import Reliability, credence_reliability
from training.canvas import AFTER, BEFORE, INK, SOFT, Axes, panels
from training.compare_noise import HEADINGS, Compared, baselines, compare, place, rows
from training.corpus import RECORDINGS, written
from training.memory_gain import WORLDS, Gain, Plan, measure
from training.progress import bar
from training.recent_credence import CredenceScore, learn_credence, right
from training.recent_credence import Plan as CredencePlan

PAGE = Path(__file__).parent / "templates" / "noise_models.md"
SHIPPED = ("srf08-mlp", "srf08-lstm", "srf08-hybrid")
EDGES = np.linspace(0.0, 6.6, 301)  # m; bins of the table of credence given one reading
BAYES, ALONE, RECENT = "Bayes over the conditions met", "learned, this reading", "learned, last 8 readings"


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym noise-report`."""

    data: Path = Path("corpus")
    """Folder for the recordings; those that are there already are not made again."""
    docs: Path = Path("docs")
    """Folder to write noise-models.md and images/noise-credence.png to."""
    models: tuple[str, ...] = SHIPPED
    """Models to compare with the baselines, by name or folder."""
    sessions: int = 40
    """Sessions of each world in which the worth of memory is measured."""


def main(args: Args) -> None:
    """Score everything and write the page."""
    with bar("scoring", len(RECORDINGS) + len(WORLDS) + 4) as progress:
        step = iter(range(1, 1000))
        tick = lambda: progress(next(step), len(RECORDINGS) + len(WORLDS) + 4)  # noqa: E731
        recordings = {}
        for name in RECORDINGS:
            recordings[name] = Recording.load(written(args.data, name))
            tick()
        models = {name.split("/")[-1]: load_model(name) for name in args.models}
        rivals = baselines(recordings["known"])
        compared = {}
        for name in ("cells", "units"):
            compared[name] = compare(recordings[name], {**rivals, **models})
            tick()
        gains = {}
        for name, world in WORLDS.items():
            gains[name] = measure(world, Plan(sessions=args.sessions))
            tick()
        given = {name: trust(models[args.models[0].split("/")[-1]], recordings, name) for name in ("cells", "units")}
    write_bytes(args.docs / "images" / "noise-credence.png", figure(models, recordings, given))
    write_text(args.docs / "noise-models.md", page(compared, gains, given, condition_rows(models, recordings)))
    print(f"{args.docs / 'noise-models.md'}: written")


def trust(model: SonarModel, recordings: Mapping[str, Recording], name: str) -> dict[str, CredenceScore]:
    """Return how good credence given the readings is, on fresh sessions of known or of other sensors."""
    train, choose, test = recordings["train"], recordings["validation"], recordings[f"fresh-{name}"]
    ping, reading = test.ping, test.reading
    echo, visit = reading.echo, np.unique(np.stack([test.run, test.cell]), axis=1, return_inverse=True)[1].ravel()
    some = np.random.default_rng(0).permutation(len(train))[:20_000]
    said: dict[str, Floats] = {BAYES: CredenceTable.over(model, train.ping[some], EDGES).given(reading)}
    for label, depth in ((ALONE, 1), (RECENT, 8)):
        said[label] = learn_credence(train, choose, CredencePlan(depth)).follow(ping, reading)
    true = right(ping, reading)
    return {label: CredenceScore.of(value[echo], true[echo], visit[echo]) for label, value in said.items()}


def condition_rows(models: Mapping[str, SonarModel], recordings: Mapping[str, Recording]) -> str:
    """Return how credence given the condition compares with each condition's own share and its Wilson interval."""
    lines = []
    for where in ("cells", "units"):
        test = recordings[where]
        cell, true = place(test), right(test.ping, test.reading)
        hits, trials = np.bincount(cell, weights=true), np.bincount(cell)
        low, high = wilson(hits, trials)
        for name, model in models.items():
            law = follow(model, test.ping, test.reading)
            mean = np.bincount(cell, weights=law.credence()) / trials
            gap = credence_reliability(law, test.reading, cell).gap
            off, share = np.abs(mean - hits / trials).mean(), 100 * float(((mean >= low) & (mean <= high)).mean())
            lines.append(f"| {WHERE[where]} | {name} | {gap:.3f} | {off:.3f} | {share:.0f} % |")
    return "\n".join(lines)


WHERE = {"cells": "other conditions, known sensors", "units": "other sensors"}


def page(
    compared: Mapping[str, Compared],
    gains: Mapping[str, Gain],
    given: Mapping[str, Mapping[str, CredenceScore]],
    condition: str,
) -> str:
    """Return the page in Markdown."""
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        commit=_commit(),
        condition=condition,
        gains="\n".join(f"| {name} | {g.without} | {g.gain} |" for name, g in gains.items()),
        given="\n".join(_given_rows(given)),
        **{name: _table(one) for name, one in compared.items()},
    )


def _table(compared: Compared) -> str:
    score = compared.repeatability
    head = f"{score.pings} fresh pings in {score.clusters} conditions, standard errors over these."
    lines = [f"| {' | '.join(row)} |" for row in (HEADINGS, ("---",) * len(HEADINGS), *rows(compared))]
    return "\n".join([head, "", *lines])


def _given_rows(given: Mapping[str, Mapping[str, CredenceScore]]) -> list[str]:
    return [
        f"| {WHERE[where]} | {label} | {s.log_score} | {s.brier} | {s.reliability.gap:.3f} |"
        for where, scores in given.items()
        for label, s in scores.items()
    ]


def _commit() -> str:
    """Return the commit of the working tree that this file is in, or that it is unknown."""
    told = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    return told.stdout.strip() or "unknown"


def figure(
    models: Mapping[str, SonarModel],
    recordings: Mapping[str, Recording],
    given: Mapping[str, Mapping[str, CredenceScore]],
) -> bytes:
    """Return reliability diagrams of both kinds of credence, on other conditions and on other sensors, as PNG."""
    draws = []
    for where in ("cells", "units"):
        test = recordings[where]
        curves = {
            n: credence_reliability(follow(m, test.ping, test.reading), test.reading, place(test))
            for n, m in models.items()
        }
        draws.append(partial(_diagram, title=f"given the condition: {WHERE[where]}", curves=curves))
    for where, scores in given.items():
        curves = {label: score.reliability for label, score in scores.items()}
        draws.append(partial(_diagram, title=f"given the readings: {WHERE[where]}", curves=curves))
    return panels(draws, (10.0, 9.0), columns=2)


def _diagram(ax: Axes, title: str, curves: Mapping[str, Reliability]) -> None:
    ax.plot([0, 1], [0, 1], color=SOFT, lw=1)
    for (label, curve), colour, mark in zip(curves.items(), (BEFORE, SOFT, AFTER), "s^o", strict=True):
        seen: NDArray[np.bool_] = curve.pings >= 20
        name = f"{label} (gap {curve.gap:.3f})"
        ax.errorbar(
            curve.said[seen], curve.came_true[seen], curve.error[seen], color=colour, marker=mark, ms=4, label=name
        )
    ax.set(title=title, xlabel="credence said", ylabel="came true", xlim=(0, 1), ylim=(0, 1))
    ax.legend(loc="upper left")
    ax.tick_params(colors=INK)
