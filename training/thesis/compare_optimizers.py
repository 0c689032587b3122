"""Train the thesis's networks on a recording and compare tables and figures with the printed ones.

The output is tables 4.2 to 4.4 and figures 4.3 to 4.6, 5.1 and A.1. A missing recording is made with the rig and the
thesis's plan. Each network is saved in OUT/networks as soon as it is trained, so an interrupted run can be continued.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from acquisition import Recording, SettingError
from acquisition.io.files import write_bytes, write_text
from training.common.canvas import AFTER, BEFORE, SOFT, Axes, Draw, panels
from training.common.progress import bars
from training.common.tables import markdown_table
from training.recordings import record
from training.thesis.data import (
    A1_MINUTES,
    A1_TRAIN,
    A1_VALIDATION,
    TABLE_NUMBER,
    TABLES,
    Floats,
    OptimiserName,
    Samples,
)
from training.thesis.experiment import Comparison, Mean, ThesisFindings, TrainingJob, made_by, train_all
from training.thesis.fit import OPTIMISERS, Recipe, TrainingResult, device_of
from training.thesis.surfaces import MIRROR, RUBBER, SHORT_RANGE, surfaces_figure

COLOURS = ("#999999", "#d55e00", "#e69f00", "#0072b2", "#009e73", "#000000")  # Okabe and Ito, colour-blind safe
CAPTIONS = {
    "figure-4.3": "Validation loss after each pass, by optimiser and number of neurons; bands span the seeds",
    "figure-4.4": "Training and validation loss of MLP and LSTM",
    "figure-4.5": "Credence of readings and mapped readings, mirror",
    "figure-4.6": "Credence of readings and mapped readings, rubber",
    "figure-5.1": "Credence of readings and mapped readings, both reflectors",
    "figure-a.1": "Training and validation loss of 30 neurons, here and in the thesis",
}


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym compare-optimizers`."""

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording of the thesis's plan (CSV); made with the rig if it does not exist."""
    out: Path
    """Folder for networks, tables and figures."""
    page: Path | None = None
    """Folder for tables and figures, if not OUT."""
    seeds: int = 5
    """Number of trainings of each network, each with another split, initial weights and order."""
    sizes: tuple[int, ...] = (10, 15, 20)
    """Hidden neurons of the tables."""
    epochs: int = 15
    """Passes over the training pings; figure A.1 takes a third more."""
    batch: int = 1
    """Pings per step; 1 is online training, as in the thesis."""
    dropout: float = 0.05
    """Fraction of hidden units dropped at each step."""
    l1: float = 0.0
    """Weight of the sum of |w| in the objective."""
    l2: float = 0.0
    """Weight of the sum of w^2 in the objective (weight decay); with l1, an elastic net."""
    patience: int | None = None
    """Passes without a lower validation loss after which training stops; by default it does not stop early."""
    device: str = "cpu"
    """Device for mini-batches: cpu, cuda, cuda:1."""
    rig_seed: int = 1
    """Seed of the recording, if it is made."""

    @property
    def comparison(self) -> Comparison:
        """The networks to train.

        Raises:
            SettingError: there is no network to train, or a setting is out of range.
        """
        if self.seeds < 1 or not self.sizes or min(self.sizes) < 1:
            raise SettingError(f"seeds {self.seeds} and sizes {self.sizes} must be at least 1")
        recipe = Recipe("nadam", self.epochs, self.batch, self.dropout, self.l1, self.l2, self.patience, self.device)
        return Comparison(recipe, self.seeds, self.sizes)


def main(args: Args) -> None:
    """Make the recording if it is missing, train missing networks, write tables and figures."""
    comparison = args.comparison
    device_of(args.device)
    if not args.recording.exists():
        record.main(record.Args(args.recording, driver="rig", plan="thesis", seed=args.rig_seed))
    origin, samples = _origin(args), Samples.of(Recording.load(args.recording))
    findings = ThesisFindings(comparison, _trained(comparison.jobs, samples, args.out / "networks"), samples)
    folder = args.page or args.out
    figures = all_figures(findings)
    for name, image in figures.items():
        write_bytes(folder / f"{name}.png", image)
    text = page(findings, origin, figures)
    write_text(folder / "tables.md", text)
    print(text)


def _trained(jobs: list[TrainingJob], samples: Samples, folder: Path) -> dict[TrainingJob, TrainingResult]:
    """Train networks and show the number of passes in a progress bar."""
    with bars() as progress:
        task = progress.add_task("training", total=None)

        def report(job: TrainingJob, done: int, total: int) -> None:
            name = f"{job.network.kind} {job.network.hidden}, {job.recipe.optimiser}, seed {job.seed}"
            progress.update(task, completed=done, total=total, description=name)

        return train_all(jobs, samples, folder, report)


def _origin(args: Args) -> str:
    """Return a sentence with command, commit and seeds."""
    made = made_by("compare-optimizers", [args.recording.name, "--out", args.out.name], args)
    return f"{made}; means over seeds 0 to {args.seeds - 1} with 95 % intervals (Student's t)."


def page(findings: ThesisFindings, origin: str, figures: Iterable[str]) -> str:
    """Return the tables and figures in Markdown.

    Args:
        findings: results.
        origin: sentence with the command and the commit.
        figures: names of the images in the same folder.
    """
    numbered = [hidden for hidden in findings.comparison.sizes if hidden in TABLES]
    parts = [
        f"# The thesis's networks on a recording\n\n{origin}",
        _losses_without_training(findings.samples),
        *[f"## Table {TABLE_NUMBER[hidden]}: {hidden} neurons\n\n{_table(findings, hidden)}" for hidden in numbered],
        f"## Ranking\n\n{_ranking(findings, numbered)}" if numbered else "",
        f"## Figures 4.4 and A.1\n\n{_larger_networks(findings)}",
        f"## Other ways to train\n\n{_variants(findings)}",
        f"## Credence, mean over conditions\n\n{_credence(findings)}",
        f"## Claims of the thesis\n\n{_claims(findings)}",
        *[f"## {name.replace('-', ' ').capitalize()}\n\n![{CAPTIONS[name]}]({name}.png)" for name in figures],
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _losses_without_training(samples: Samples) -> str:
    silent = 100.0 * np.mean(samples.range == 0.0)
    return (
        f"{len(samples)} pings in {samples.condition.max() + 1} conditions; {silent:.1f} % without echo. The mean "
        f"distance as output for every ping has a loss of {np.var(samples.label):.4f}. The minimum loss of any "
        f"function of the four inputs is {samples.loss_floor():.4f}, the variance of labels of pings with equal inputs."
    )


def _table(findings: ThesisFindings, hidden: int) -> str:
    """Return one of tables 4.2 to 4.4, each column of the thesis followed by the one obtained here."""
    header = "optimiser|train, thesis|train|validation, thesis|validation|rank, thesis|rank|minutes, thesis|seconds"
    printed, ranks = TABLES[hidden], findings.ranks(hidden)
    printed_ranks = {name: rank for rank, name in enumerate(sorted(printed, key=lambda n: printed[n].validation), 1)}

    def row(name: OptimiserName, optimiser: str) -> tuple[object, ...]:
        jobs, old = findings.comparison.table(hidden, name), printed[name]
        train, validation = Mean.of(findings.final(jobs, "train")), Mean.of(findings.final(jobs))
        losses = f"{old.train:.4f}", train, f"{old.validation:.4f}", validation
        return (optimiser, *losses, printed_ranks[name], ranks[name], f"{old.minutes:.2f}", _seconds(findings, jobs))

    return markdown_table(header.split("|"), [row(name, optimiser.title) for name, optimiser in OPTIMISERS.items()])


def _seconds(findings: ThesisFindings, jobs: list[TrainingJob]) -> str:
    return f"{np.median(findings.final(jobs, 'seconds')):.1f}"


def _ranking(findings: ThesisFindings, sizes: list[int]) -> str:
    """Return the rank correlation of the optimisers' losses with the thesis's."""

    def row(hidden: int) -> tuple[object, ...]:
        rho, tau, single = findings.agreement(hidden)
        return hidden, f"{rho:.2f}", f"{tau:.2f}", f"{single.min():.2f} to {single.max():.2f}"

    return markdown_table(("neurons", "Spearman's rho", "Kendall's tau", "rho of single seeds"), map(row, sizes))


def _larger_networks(findings: ThesisFindings) -> str:
    """Return the losses of the networks of figures 4.4 and A.1."""
    header = "network|train, thesis|train|validation, thesis|validation|best validation|minutes, thesis|seconds"
    comparison, printed = findings.comparison, (f"{A1_TRAIN[-1]:.4f}", f"{A1_VALIDATION[-1]:.4f}", f"{A1_MINUTES:.1f}")

    def row(jobs: list[TrainingJob], thesis: tuple[str, str, str] = ("–", "–", "–")) -> tuple[object, ...]:
        network, final = jobs[0].network, Mean.of(findings.final(jobs))
        name = f"{network.kind.upper()}, {network.hidden} units, {jobs[0].recipe.epochs} passes"
        best = Mean.of([findings.results[job].validation.min() for job in jobs])
        train, seconds = Mean.of(findings.final(jobs, "train")), _seconds(findings, jobs)
        return name, thesis[0], train, thesis[1], final, best, thesis[2], seconds

    rows = [row(comparison.mlp), row(comparison.lstm), row(comparison.long, printed)]
    return markdown_table(header.split("|"), rows)


def _variants(findings: ThesisFindings) -> str:
    """Return the effect of changes to the recipe on the last network of the tables."""
    base = findings.final(findings.comparison.variants["as the tables"])
    rows: list[tuple[object, ...]] = []
    for name, jobs in findings.comparison.variants.items():
        final = findings.final(jobs)
        rows.append((name, Mean.of(final), Mean.of(final - base) if rows else "–", _seconds(findings, jobs)))
    return markdown_table(("Nadam with", "validation", "change, paired by seed", "seconds"), rows)


def _credence(findings: ThesisFindings) -> str:
    """Return the mean credence of readings and of the networks' estimates, by reflector and range."""
    surfaces = findings.surfaces
    every, near = np.ones(len(surfaces.distance), dtype=bool), surfaces.distance < SHORT_RANGE
    subsets = {"": every, ", below 500 mm": near, ", conditions without any echo": surfaces.silent}
    columns = {f"{r}{text}": surfaces.of(r) & chosen for r in (MIRROR, RUBBER) for text, chosen in subsets.items()}
    rows = [[name, *(_share(surfaces.mean(name, chosen)) for chosen in columns.values())] for name in surfaces.names]
    return markdown_table(["", *columns], rows)


def _share(values: Floats) -> str:
    mean = Mean.of(values)
    return f"{mean.value:.3f}" + (f" ± {mean.half:.3f}" if len(values) > 1 else "")


def _claims(findings: ThesisFindings) -> str:
    rows = [(claim.thesis, claim.here, claim.verdict) for claim in findings.claims()]
    return markdown_table(("the thesis", "here", "result"), rows)


def all_figures(findings: ThesisFindings) -> dict[str, bytes]:
    """Return the figures as PNG, by their number in the thesis."""
    comparison, surfaces = findings.comparison, findings.surfaces
    units, (hidden, _) = comparison.figure, comparison.longest
    pair = [(comparison.mlp, f"MLP, {units} neurons"), (comparison.lstm, f"LSTM, {units} cells")]
    curves = [_training(findings, jobs, title) for jobs, title in pair]
    longest = _training(findings, comparison.long, f"{hidden} neurons, this recording")
    tables = [_optimisers(findings, hidden) for hidden in comparison.sizes]
    return {
        "figure-4.3": panels(tables, (3.2 * len(tables), 3.4), share_y=True),
        "figure-4.4": panels(curves, (7.0, 3.2), share_y=True),
        "figure-a.1": panels([longest, _printed], (7.0, 3.2)),
        "figure-4.5": surfaces_figure(surfaces, (MIRROR,)),
        "figure-4.6": surfaces_figure(surfaces, (RUBBER,)),
        "figure-5.1": surfaces_figure(surfaces, (MIRROR, RUBBER)),
    }


def _band(axes: Axes, losses: Floats, colour: str, label: str, style: str = "-") -> None:
    """Draw the mean and the range over seeds."""
    passes = np.arange(1, losses.shape[1] + 1)
    axes.plot(passes, losses.mean(axis=0), color=colour, lw=1.6, label=label, ls=style)
    axes.fill_between(passes, losses.min(axis=0), losses.max(axis=0), color=colour, alpha=0.18, lw=0)


def _floor(axes: Axes, findings: ThesisFindings) -> None:
    axes.axhline(findings.samples.loss_floor(), color=SOFT, lw=0.9, ls=":", label="minimum of any function")


def _optimisers(findings: ThesisFindings, hidden: int) -> Draw:
    def draw(axes: Axes) -> None:
        for (name, optimiser), colour in zip(OPTIMISERS.items(), COLOURS, strict=True):
            losses = findings.curves(findings.comparison.table(hidden, name), "validation")
            _band(axes, losses, colour, optimiser.title)
        _floor(axes, findings)
        axes.set(xlabel="passes", title=f"{hidden} neurons")
        if hidden == findings.comparison.sizes[0]:
            axes.set(ylabel="validation loss")
        if hidden == findings.comparison.sizes[-1]:
            axes.legend(loc="upper right", fontsize=7, ncol=2)

    return draw


def _training(findings: ThesisFindings, jobs: list[TrainingJob], title: str) -> Draw:
    def draw(axes: Axes) -> None:
        _band(axes, findings.curves(jobs, "train"), BEFORE, "training (dropout on)", "--")
        _band(axes, findings.curves(jobs, "validation"), AFTER, "validation")
        _floor(axes, findings)
        axes.set(xlabel="passes", ylabel="loss", title=title)
        axes.legend(fontsize=8)

    return draw


def _printed(axes: Axes) -> None:
    passes = np.arange(1, len(A1_TRAIN) + 1)
    axes.plot(passes, A1_TRAIN, color=BEFORE, lw=1.6, ls="--", label="training (dropout on)")
    axes.plot(passes, A1_VALIDATION, color=AFTER, lw=1.6, label="validation")
    axes.set(xlabel="passes", ylabel="loss", title="30 neurons, in the thesis")
    axes.legend(fontsize=8)
