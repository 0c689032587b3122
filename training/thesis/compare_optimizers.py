"""Train the thesis's networks on a recording, and compare the results with its tables and figures.

It makes tables 4.2 to 4.4 and figures 4.3 to 4.6, 5.1 and A.1. If the recording does not exist, the rig records the
thesis's survey. Each network is saved in OUT/networks as soon as it is trained, so an interrupted run can be resumed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from annotated_types import MinLen

from acquisition import Recording, SettingError
from acquisition.io.files import write_bytes, write_text
from acquisition.io.places import OutputFolder
from acquisition.limits import Count, Limit, Seed, Share
from training.common.canvas import AFTER, BEFORE, SOFT, Axes, Draw, panels
from training.common.progress import bars
from training.common.tables import markdown_table
from training.recordings import record
from training.thesis.data import A1_MINUTES, A1_TRAIN, A1_VALIDATION, TABLE_NUMBER, TABLES, Floats, Samples
from training.thesis.experiment import (
    A1_UNITS,
    FIGURE_UNITS,
    TABLE_SETTINGS,
    Comparison,
    SeedMean,
    ThesisFindings,
    TrainingJob,
    provenance,
    train_all,
)
from training.thesis.fit import OPTIMISERS, Fitted, Recipe, device_of
from training.thesis.surfaces import MIRROR, READINGS, RUBBER, SHORT_RANGE_M, CredenceSurfaces

# colours of Okabe and Ito, distinguishable with colour-vision deficiency
COLOURS = ("#999999", "#d55e00", "#e69f00", "#0072b2", "#009e73", "#000000")
CAPTIONS = {
    "figure-4.3": "Validation loss after each epoch, by optimiser and number of neurons; bands span the seeds",
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
    """Recording of the thesis's survey (CSV); recorded with the rig if the file does not exist."""
    out: OutputFolder
    """Folder for networks, tables and figures."""
    page: OutputFolder | None = None
    """Folder for tables and figures, if different from OUT."""
    seeds: Annotated[int, Limit(1, 1000)] = 5
    """Number of trainings of each network; each has its own split, initial weights and order."""
    sizes: Annotated[tuple[Annotated[int, Limit(1, 4096)], ...], MinLen(1)] = (10, 15, 20)
    """Hidden neurons of the tables."""
    epochs: Count = 15
    """Passes over the training pings; figure A.1 uses a third more."""
    batch: Count = 1
    """Pings per step; 1 is online training, as in the thesis."""
    dropout: Annotated[float, Limit(0.0, 1.0, open_high=True)] = 0.05
    """Share of hidden units dropped at each step."""
    l1: Share = 0.0
    """Coefficient of the sum of |w| in the objective."""
    l2: Share = 0.0
    """Coefficient of the sum of w^2 (weight decay); together with l1 an elastic net."""
    patience: Count | None = None
    """Epochs without a lower validation loss after which training stops; by default it never stops early."""
    device: str = "cpu"
    """Device on which mini-batches are trained: cpu, cuda, cuda:1."""
    rig_seed: Seed = 1
    """Seed of the recording, if it has to be made."""

    @property
    def comparison(self) -> Comparison:
        """The networks to train."""
        if self.seeds < 1 or not self.sizes or min(self.sizes) < 1:
            raise SettingError(f"seeds {self.seeds} and sizes {self.sizes} must be at least 1")
        recipe = Recipe("nadam", self.epochs, self.batch, self.dropout, self.l1, self.l2, self.patience, self.device)
        return Comparison(recipe, self.seeds, self.sizes)


def main(args: Args) -> None:
    """Record if necessary, train the missing networks, write tables and figures."""
    comparison = args.comparison
    device_of(args.device)
    if not args.recording.exists():
        record.main(record.Args(args.recording, driver="rig", plan="thesis", seed=args.rig_seed))
    made = provenance(["compare-optimizers", args.recording.name, "--out", args.out.name], args)
    about = f"{made}; means over seeds 0 to {args.seeds - 1} with 95 % intervals (Student's t)."
    samples = Samples.of(Recording.load(args.recording))
    findings = ThesisFindings(comparison, _train(comparison.jobs, samples, args.out / "networks"), samples)
    folder = args.page or args.out
    figures = all_figures(findings)
    for name, image in figures.items():
        write_bytes(folder / f"{name}.png", image)
    text = page(findings, about, figures)
    write_text(folder / "tables.md", text)
    print(text)


def _train(jobs: list[TrainingJob], samples: Samples, folder: Path) -> dict[TrainingJob, Fitted]:
    """Train networks and show a progress bar of the epochs."""
    with bars() as progress:
        task = progress.add_task("training", total=None)

        def report(job: TrainingJob, done: int, total: int) -> None:
            text = f"{job.network.kind} {job.network.hidden}, {job.recipe.optimiser}, seed {job.seed}"
            progress.update(task, completed=done, total=total, description=text)

        return train_all(jobs, samples, folder, report)


def page(findings: ThesisFindings, about: str, figures: Iterable[str] = ()) -> str:
    """Return a page of all tables.

    Args:
        findings: results.
        about: the command and commit that made the page.
        figures: names of the images in the page's folder.
    """
    numbered = [hidden for hidden in findings.comparison.sizes if hidden in TABLES]
    tables = [(f"Table {TABLE_NUMBER[hidden]}: {hidden} neurons", _table(findings, hidden)) for hidden in numbered]
    sections = [
        *tables,
        *([("Ranking", _ranking(findings, numbered))] if numbered else []),
        ("Figures 4.4 and A.1", _larger_networks(findings)),
        ("Other training settings", _variants(findings)),
        ("Credence, mean over conditions", _credence(findings)),
        ("Statements of the thesis", _claims(findings)),
        *[(name.replace("-", " ").capitalize(), f"![{CAPTIONS[name]}]({name}.png)") for name in figures],
    ]
    title = f"# The thesis's networks on a recording\n\n{about}\n\n{_loss_limits(findings.samples)}\n"
    return "\n".join([title, *(f"## {heading}\n\n{text}\n" for heading, text in sections)])


def _loss_limits(samples: Samples) -> str:
    silent = 100.0 * np.mean(samples.feature[:, 2] == 0.0)
    return (
        f"{len(samples)} pings on {samples.condition.max() + 1} conditions; {silent:.1f} % silent. The mean distance "
        f"as the output for each ping has a loss of {np.var(samples.label):.4f}; no function of the four inputs has a "
        f"loss below {samples.loss_floor():.4f}, the variance of the labels among pings with equal inputs."
    )


def _table(findings: ThesisFindings, hidden: int) -> str:
    """Return one of tables 4.2 to 4.4, each column next to that of the thesis."""
    header = "optimiser|train, thesis|train|validation, thesis|validation|rank, thesis|rank|minutes, thesis|seconds"
    printed, ranks = TABLES[hidden], findings.ranks(hidden)
    printed_ranks = {n: rank for rank, n in enumerate(sorted(printed, key=lambda n: printed[n].validation), 1)}
    rows = []
    for name, optimiser in OPTIMISERS.items():
        row, (train, validation, seconds) = printed[name], _results(findings, findings.comparison.table(hidden, name))
        losses = f"{row.train:.4f}", train, f"{row.validation:.4f}", validation
        rows.append((optimiser.title, *losses, printed_ranks[name], ranks[name], f"{row.minutes:.2f}", seconds))
    return markdown_table(header.split("|"), rows)


def _results(findings: ThesisFindings, jobs: list[TrainingJob]) -> tuple[SeedMean, SeedMean, str]:
    """Return training loss, validation loss and the median time in seconds."""
    train, validation = SeedMean.of(findings.final(jobs, "train")), SeedMean.of(findings.final(jobs))
    return train, validation, f"{np.median(findings.final(jobs, 'seconds')):.1f}"


def _ranking(findings: ThesisFindings, sizes: list[int]) -> str:
    """Return the rank correlations with the thesis's tables."""
    rows = []
    for hidden in sizes:
        rho, tau, single = findings.agreement(hidden)
        rows.append((hidden, f"{rho:.2f}", f"{tau:.2f}", f"{single.min():.2f} to {single.max():.2f}"))
    return markdown_table(("neurons", "Spearman's rho", "Kendall's tau", "rho of single seeds"), rows)


def _larger_networks(findings: ThesisFindings) -> str:
    header = "network|train, thesis|train|validation, thesis|validation|best validation|minutes, thesis|seconds"
    unprinted, printed = ("–", "–", "–"), (f"{A1_TRAIN[-1]:.4f}", f"{A1_VALIDATION[-1]:.4f}", f"{A1_MINUTES:.1f}")
    comparison, rows = findings.comparison, []
    for jobs, thesis in ((comparison.mlp, unprinted), (comparison.lstm, unprinted), (comparison.a1, printed)):
        network, epochs = jobs[0].network, jobs[0].recipe.epochs
        train, validation, seconds = _results(findings, jobs)
        best = SeedMean.of([findings.fitted[job].validation.min() for job in jobs])
        name = f"{network.kind.upper()}, {network.hidden} units, {epochs} epochs"
        rows.append((name, thesis[0], train, thesis[1], validation, best, thesis[2], seconds))
    return markdown_table(header.split("|"), rows)


def _variants(findings: ThesisFindings) -> str:
    """Return the effects of other settings on the largest network of the tables."""
    base = findings.final(findings.comparison.variants[TABLE_SETTINGS])
    rows: list[tuple[object, ...]] = []
    for name, jobs in findings.comparison.variants.items():
        change = "–" if name == TABLE_SETTINGS else SeedMean.of(findings.final(jobs) - base)
        _, validation, seconds = _results(findings, jobs)
        rows.append((name, validation, change, seconds))
    return markdown_table(("Nadam with", "validation", "change, paired by seed", "seconds"), rows)


def _credence(findings: ThesisFindings) -> str:
    """Return the mean credence of readings and of networks' outputs by reflector and range."""
    surfaces = findings.surfaces
    every, near = np.ones(len(surfaces.distance), dtype=bool), surfaces.distance < SHORT_RANGE_M
    subsets = {"": every, ", below 500 mm": near, ", without any echo": surfaces.silent}
    columns = {f"{r}{text}": surfaces.of(r) & subset for r in (MIRROR, RUBBER) for text, subset in subsets.items()}
    rows = [[name, *(_share(surfaces.mean(name, c)) for c in columns.values())] for name in surfaces.credence]
    return markdown_table(["", *columns], rows)


def _share(values: Floats) -> str:
    return SeedMean.of(values).shown(3)


def _claims(findings: ThesisFindings) -> str:
    rows = [(claim.thesis, claim.here, claim.verdict) for claim in findings.claims()]
    return markdown_table(("the thesis", "here", ""), rows)


def all_figures(findings: ThesisFindings) -> dict[str, bytes]:
    """Return each figure as PNG by its number in the thesis, without those of a reflector that was not measured."""
    comparison = findings.comparison
    tables = [_optimisers(findings, hidden) for hidden in comparison.sizes]
    mlp = _training(findings, comparison.mlp, f"MLP, {FIGURE_UNITS} neurons")
    lstm = _training(findings, comparison.lstm, f"LSTM, {FIGURE_UNITS} cells")
    a1 = _training(findings, comparison.a1, f"{A1_UNITS} neurons, this recording")
    figures = {
        "figure-4.3": panels(tables, (3.2 * len(tables), 3.4), share_y=True),
        "figure-4.4": panels([mlp, lstm], (7.0, 3.2), share_y=True),
        "figure-a.1": panels([a1, _printed_training], (7.0, 3.2)),
    }
    surfaces = {"figure-4.5": (MIRROR,), "figure-4.6": (RUBBER,), "figure-5.1": (MIRROR, RUBBER)}
    was_measured = {reflector: bool(findings.surfaces.of(reflector).any()) for reflector in (MIRROR, RUBBER)}
    for name, reflectors in surfaces.items():
        if all(was_measured[reflector] for reflector in reflectors):
            figures[name] = _surfaces(findings, reflectors)
    return figures


def _plot_band(axes: Axes, losses: Floats, colour: str, label: str, style: str = "-") -> None:
    """Plot the mean over seeds and their range."""
    epochs = np.arange(1, losses.shape[1] + 1)
    axes.plot(epochs, losses.mean(axis=0), color=colour, lw=1.6, label=label, ls=style)
    axes.fill_between(epochs, losses.min(axis=0), losses.max(axis=0), color=colour, alpha=0.18, lw=0)


def _plot_floor(axes: Axes, findings: ThesisFindings) -> None:
    axes.axhline(findings.samples.loss_floor(), color=SOFT, lw=0.9, ls=":", label="lower bound")


def _optimisers(findings: ThesisFindings, hidden: int) -> Draw:
    def draw(axes: Axes) -> None:
        for (name, optimiser), colour in zip(OPTIMISERS.items(), COLOURS, strict=True):
            losses = findings.curves(findings.comparison.table(hidden, name), "validation")
            _plot_band(axes, losses, colour, optimiser.title)
        _plot_floor(axes, findings)
        axes.set(xlabel="epoch", title=f"{hidden} neurons")
        if hidden == findings.comparison.sizes[0]:
            axes.set(ylabel="validation loss")
        if hidden == findings.comparison.sizes[-1]:
            axes.legend(loc="upper right", fontsize=7, ncol=2)

    return draw


def _training(findings: ThesisFindings, jobs: list[TrainingJob], title: str) -> Draw:
    def draw(axes: Axes) -> None:
        _plot_band(axes, findings.curves(jobs, "train"), BEFORE, "training (dropout on)", "--")
        _plot_band(axes, findings.curves(jobs, "validation"), AFTER, "validation")
        _plot_floor(axes, findings)
        axes.set(xlabel="epoch", ylabel="loss", title=title)
        axes.legend(fontsize=8)

    return draw


def _printed_training(axes: Axes) -> None:
    epochs = np.arange(1, len(A1_TRAIN) + 1)
    axes.plot(epochs, A1_TRAIN, color=BEFORE, lw=1.6, ls="--", label="training (dropout on)")
    axes.plot(epochs, A1_VALIDATION, color=AFTER, lw=1.6, label="validation")
    axes.set(xlabel="epoch", ylabel="loss", title="30 neurons, in the thesis")
    axes.legend(fontsize=8)


def _surfaces(findings: ThesisFindings, reflectors: Sequence[str]) -> bytes:
    """Draw the credence of readings and of the outputs of MLP and LSTM, one row per reflector."""
    names = {READINGS: "readings", "MLP": "mapped by MLP", "LSTM": "mapped by LSTM"}
    draws = [_surface(findings.surfaces, k, r, f"{r}: {text}") for r in reflectors for k, text in names.items()]
    size = (9.0, 2.8 * len(reflectors))
    return panels(draws, size, columns=len(names), colours=("credence", 0.0, 1.0))


def _surface(surfaces: CredenceSurfaces, name: str, reflector: str, title: str) -> Draw:
    def draw(axes: Axes) -> None:
        subset = surfaces.of(reflector)
        angle, distance, value = grid(
            surfaces.angle[subset], surfaces.distance[subset], surfaces.credence[name][0, subset]
        )
        a, d = np.meshgrid(np.deg2rad(np.clip(bin_edges(angle), 0.0, None)), bin_edges(distance), indexing="ij")
        axes.pcolormesh(d * np.cos(a), d * np.sin(a), value, vmin=0.0, vmax=1.0, cmap="viridis", rasterized=True)
        axes.set(aspect="equal", facecolor="#f4f5f7")
        axes.set_xlabel("along the axis (m)", fontsize=9)
        axes.set_ylabel("across the axis (m)", fontsize=9)
        axes.set_title(title, fontsize=9)
        axes.tick_params(labelsize=8)

    return draw


def grid(angle: Floats, distance: Floats, value: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the distinct angles and distances of a survey and the values on their grid, nan where not measured."""
    angles, row = np.unique(np.round(angle, 6), return_inverse=True)
    distances, column = np.unique(np.round(distance, 4), return_inverse=True)
    out = np.full((len(angles), len(distances)), np.nan)
    out[row, column] = value
    return angles, distances, out


def bin_edges(centre: Floats) -> Floats:
    """Return the edges of bins about their centres, halfway between neighbours, (n + 1,).

    >>> bin_edges(np.array([0.0, 1.0, 3.0]))
    array([-0.5,  0.5,  2. ,  4. ])
    """
    if len(centre) == 1:
        return centre[0] + np.array([-0.5, 0.5])
    half = np.diff(centre) / 2
    return np.concatenate([[centre[0] - half[0]], centre[:-1] + half, [centre[-1] + half[-1]]])
