"""The tables of a comparison in Markdown, beside the thesis's own numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from training.thesis.credence import MIRROR, RUBBER, SHORT_M
from training.thesis.data import Floats
from training.thesis.findings import Findings, Mean
from training.thesis.numbers import A1_MINUTES, A1_TRAIN, A1_VALIDATION, TABLE_NUMBER, TABLES
from training.thesis.optimisers import OPTIMISERS
from training.thesis.runs import Job

CAPTIONS = {
    "figure-4.3": "Validation loss after each pass, by optimiser and number of neurons; bands span the seeds",
    "figure-4.4": "Training and validation loss of MLP and LSTM",
    "figure-4.5": "Credence of readings and mapped readings, mirror",
    "figure-4.6": "Credence of readings and mapped readings, rubber",
    "figure-5.1": "Credence of readings and mapped readings, both reflectors",
    "figure-a.1": "Training and validation loss of 30 neurons, here and in the thesis",
}


def markdown(heading: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown.

    >>> print(markdown(("a", "b"), [(1, 2)]))
    | a | b |
    |---|---|
    | 1 | 2 |
    """
    lines = [heading, ["---"] * len(heading), *rows]
    text = [f"| {' | '.join(map(str, line))} |" for line in lines]
    return "\n".join([text[0], text[1].replace(" ", ""), *text[2:]])


def page(findings: Findings, about: str, figures: Iterable[str] = ()) -> str:
    """Return all tables; `about` says what made them, `figures` are names of images beside the page."""
    numbered = [hidden for hidden in findings.comparison.sizes if hidden in TABLES]
    parts = [
        f"# The thesis's networks on a recording\n\n{about}",
        floors(findings),
        *[f"## Table {TABLE_NUMBER[hidden]}: {hidden} neurons\n\n{table(findings, hidden)}" for hidden in numbered],
        f"## Ranking\n\n{ranking(findings, numbered)}" if numbered else "",
        f"## Figures 4.4 and A.1\n\n{larger(findings)}",
        f"## Other ways to train\n\n{variants(findings)}",
        f"## Credence, mean over conditions\n\n{credence(findings)}",
        f"## What the thesis says\n\n{claims(findings)}",
        *[f"## {name.replace('-', ' ').capitalize()}\n\n![{CAPTIONS[name]}]({name}.png)" for name in figures],
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def floors(findings: Findings) -> str:
    """Return how low a loss can be here."""
    samples = findings.samples
    silent = 100.0 * np.mean(samples.feature[:, 2] == 0.0)
    return (
        f"{len(samples)} pings on {samples.condition.max() + 1} conditions; {silent:.1f} % silent. Answering each ping with "
        f"the mean distance has a loss of {np.var(samples.label):.4f}; no function of the four inputs gets below "
        f"{samples.floor():.4f}, for that is how far the labels of pings with equal inputs lie apart."
    )


def table(findings: Findings, hidden: int) -> str:
    """Return one of tables 4.2 to 4.4 with a column of the thesis's numbers beside each of ours."""
    heading = "optimiser|train, thesis|train|validation, thesis|validation|place, thesis|place|minutes, thesis|seconds"
    printed, ranks = TABLES[hidden], findings.ranks(hidden)
    places = {name: place for place, name in enumerate(sorted(printed, key=lambda n: printed[n].validation), 1)}
    rows = []
    for name, optimiser in OPTIMISERS.items():
        jobs, row = findings.comparison.table(hidden, name), printed[name]
        train, validation = Mean.of(findings.final(jobs, "train")), Mean.of(findings.final(jobs))
        seconds = f"{np.median(findings.final(jobs, 'seconds')):.1f}"
        rows.append(
            (
                *(optimiser.title, f"{row.train:.4f}", train, f"{row.validation:.4f}", validation),
                *(places[name], ranks[name], f"{row.minutes:.2f}", seconds),
            )
        )
    return markdown(heading.split("|"), rows)


def ranking(findings: Findings, sizes: list[int]) -> str:
    """Return how well the order of the optimisers agrees with the thesis's."""
    rows = []
    for hidden in sizes:
        rho, tau, single = findings.agreement(hidden)
        rows.append((hidden, f"{rho:.2f}", f"{tau:.2f}", f"{single.min():.2f} to {single.max():.2f}"))
    return markdown(("neurons", "Spearman's rho", "Kendall's tau", "rho of single seeds"), rows)


def _line(findings: Findings, name: str, jobs: list[Job], thesis: tuple[str, str, str]) -> tuple[str, ...]:
    train, validation = Mean.of(findings.final(jobs, "train")), Mean.of(findings.final(jobs))
    best = Mean.of([findings.fitted[job].validation.min() for job in jobs])
    seconds = f"{np.median(findings.final(jobs, 'seconds')):.1f}"
    return (name, thesis[0], str(train), thesis[1], str(validation), str(best), thesis[2], seconds)


def _name(job: Job) -> str:
    return f"{job.network.kind.upper()}, {job.network.hidden} units, {job.recipe.epochs} passes"


def larger(findings: Findings) -> str:
    """Return the losses of the larger networks."""
    heading = "network|train, thesis|train|validation, thesis|validation|best validation|minutes, thesis|seconds"
    drawn, printed = ("–", "–", "–"), (f"{A1_TRAIN[-1]:.4f}", f"{A1_VALIDATION[-1]:.4f}", f"{A1_MINUTES:.1f}")
    comparison = findings.comparison
    groups = ((comparison.mlp, drawn), (comparison.lstm, drawn), (comparison.long, printed))
    rows = [_line(findings, _name(jobs[0]), jobs, thesis) for jobs, thesis in groups]
    return markdown(heading.split("|"), rows)


def variants(findings: Findings) -> str:
    """Return what changes in the recipe do to the largest network of the tables."""
    base = findings.final(findings.comparison.variants["as the tables"])
    rows: list[tuple[object, ...]] = []
    for name, jobs in findings.comparison.variants.items():
        change = Mean.of(findings.final(jobs) - base) if rows else "–"
        seconds = f"{np.median(findings.final(jobs, 'seconds')):.1f}"
        rows.append((name, Mean.of(findings.final(jobs)), change, seconds))
    return markdown(("Nadam with", "validation", "change, paired by seed", "seconds"), rows)


def credence(findings: Findings) -> str:
    """Return the credence of readings and of what the networks make of them, by reflector and range."""
    surfaces = findings.surfaces
    every, near = np.ones(len(surfaces.distance), dtype=bool), surfaces.distance < SHORT_M
    where = {"": every, ", below 500 mm": near, ", never an echo": surfaces.silent}
    columns = {f"{r}{text}": surfaces.of(r) & cells for r in (MIRROR, RUBBER) for text, cells in where.items()}
    rows = [[name, *(_share(surfaces.mean(name, cells)) for cells in columns.values())] for name in surfaces.names]
    return markdown(["", *columns], rows)


def _share(values: Floats) -> str:
    mean = Mean.of(values)
    return f"{mean.value:.3f}" + (f" ± {mean.half:.3f}" if len(values) > 1 else "")


def claims(findings: Findings) -> str:
    """Return each claim of the thesis with what was found."""
    return markdown(("the thesis", "here", ""), [(c.thesis, c.here, c.verdict) for c in findings.claims()])
