"""Train the thesis's networks on a recording: tables 4.2 to 4.4, figures 4.3 to 4.6, 5.1 and A.1, beside its numbers.

A recording that is not there is made by the rig on the thesis's plan. Each network is kept in OUT/networks as soon as
it is trained, so the command goes on where it was stopped.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import tyro

from acquisition import Recording, SettingError
from acquisition.io.files import write_bytes, write_text
from training.common.commit import commit
from training.common.progress import bars
from training.recordings import record
from training.thesis.data import Samples
from training.thesis.figures import all_figures
from training.thesis.findings import Findings
from training.thesis.fit import Fitted, Recipe, device_of
from training.thesis.page import page
from training.thesis.runs import Comparison, Job, train_all


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym compare-optimizers`."""

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording of the thesis's plan (CSV); made by the rig where it is missing."""
    out: Path
    """Folder for networks, tables and figures."""
    page: Path | None = None
    """Folder for tables and figures, if not OUT."""
    seeds: int = 5
    """How often each network is trained, each time with another split, first weights and order."""
    sizes: tuple[int, ...] = (10, 15, 20)
    """Hidden neurons of the tables."""
    epochs: int = 15
    """Passes over the training pings; figure A.1 takes a third more."""
    batch: int = 1
    """Pings a step; 1 is online, as the thesis."""
    dropout: float = 0.05
    """Share of hidden units dropped at each step."""
    l1: float = 0.0
    """Weight of the sum of |w| in what is made small."""
    l2: float = 0.0
    """Weight of the sum of w^2: weight decay; together with l1 an elastic net."""
    patience: int | None = None
    """Passes without a better validation loss after which training stops; never if not given."""
    device: str = "cpu"
    """Where mini-batches are trained: cpu, cuda, cuda:1."""
    rig_seed: int = 1
    """Of the recording, where it is to be made."""

    @property
    def comparison(self) -> Comparison:
        """Which networks are trained."""
        if self.seeds < 1 or not self.sizes or min(self.sizes) < 1:
            raise SettingError(f"seeds {self.seeds} and sizes {self.sizes} must be at least 1")
        recipe = Recipe("nadam", self.epochs, self.batch, self.dropout, self.l1, self.l2, self.patience, self.device)
        return Comparison(recipe, self.seeds, self.sizes)


def main(args: Args) -> None:
    """Record if need be, train what is missing, write tables and figures."""
    comparison = args.comparison
    device_of(args.device)
    if not args.recording.exists():
        record.main(record.Args(args.recording, driver="rig", plan="thesis", seed=args.rig_seed))
    made, samples = about(args), Samples.of(Recording.load(args.recording))
    findings = Findings(comparison, trained(comparison.jobs, samples, args.out / "networks"), samples)
    folder = args.page or args.out
    figures = all_figures(findings)
    for name, image in figures.items():
        write_bytes(folder / f"{name}.png", image)
    text = page(findings, made, figures)
    write_text(folder / "tables.md", text)
    print(text)


def trained(jobs: list[Job], samples: Samples, folder: Path) -> dict[Job, Fitted]:
    """Train networks under a progress bar that counts passes."""
    total = sum(job.recipe.epochs for job in jobs)
    with bars() as progress:
        task, done = progress.add_task("training", total=total), dict.fromkeys(jobs, 0)

        def report(job: Job, epoch: int) -> None:
            done[job] = epoch
            progress.update(task, completed=sum(done.values()), description=f"{_title(job)}, seed {job.seed}")

        return train_all(jobs, samples, folder, report)


def _title(job: Job) -> str:
    return f"{job.network.kind} {job.network.hidden}, {job.recipe.optimiser}"


def about(args: Args) -> str:
    """Return what made the tables: the command and the commit."""
    words = ["sonar-gym", "compare-optimizers", args.recording.name, "--out", args.out.name]
    for f in fields(args):
        value = getattr(args, f.name)
        if f.name not in ("recording", "out", "page") and value != f.default:
            words += [f"--{f.name.replace('_', '-')}", *map(str, value if isinstance(value, tuple) else [value])]
    seeds = f"means over seeds 0 to {args.seeds - 1} with 95 % intervals (Student's t)"
    return f"Made by `{shlex.join(words)}` at commit {commit()}; {seeds}."
