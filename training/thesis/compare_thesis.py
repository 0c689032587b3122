"""Hold the rig against the thesis's own sonar, of which the networks that its author published are all that is left.

What they answer to silence tells where his sonar heard nothing. The rig records the thesis's survey at the gain that
the thesis states and at full gain, as it is and with its unknown electronics turned within their limits; networks like
his are trained on each recording, so that what a network blurs is not taken for a difference of sonars.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path

from rich.progress import TaskID

from acquisition import SettingError
from acquisition.io.files import write_bytes, write_text
from training.common.commit import commit
from training.common.progress import bars
from training.thesis.rig import Settings, compared, published
from training.thesis.rig_page import FIGURE, figure, page

TABLES = "tables.md"


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym compare-thesis`.

    Example:
        sonar-gym compare-thesis --networks MasterThesis --out rig-versus-thesis
    """

    networks: Path
    """Folder with the networks that the thesis's author published (*.h5, *.hdf5)."""
    out: Path
    """Folder for trained networks, tables and figure."""
    page: Path | None = None
    """Folder for tables and figure, if not OUT."""
    trials: int = 40
    """Units to try at each gain; 0 leaves the electronics as they are."""
    pings: int = 50
    """Pings a condition."""
    seeds: int = 3
    """How often each network is trained on each recording."""
    epochs: int = 15
    """Passes of training, as the thesis."""
    seed: int = 1
    """Of the recordings."""

    @property
    def settings(self) -> Settings:
        """How much is done.

        Raises:
            SettingError: so little that nothing is left to compare.
        """
        for name, least in (("trials", 0), ("pings", 1), ("seeds", 1), ("epochs", 1)):
            if getattr(self, name) < least:
                raise SettingError(f"--{name} must be at least {least}, got {getattr(self, name)}")
        return Settings(self.out / "networks", self.trials, self.pings, self.seeds, self.epochs, self.seed)


def main(args: Args) -> None:
    """Ask the author's networks, tune, record, train, and write tables and a figure."""
    settings, author, made = args.settings, published(args.networks), about(args)
    with _bars() as report:
        study = compared(author, settings, report)
    folder = args.page or args.out
    write_bytes(folder / FIGURE, figure(study))
    text = page(study, made)
    write_text(folder / TABLES, text)
    print(text)


@contextmanager
def _bars() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each thing that is done."""
    with bars() as progress:
        tasks: dict[str, TaskID] = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=total)
            progress.update(tasks[what], completed=done)

        yield report


def about(args: Args) -> str:
    """Return what made the tables: the command and the commit."""
    words = ["sonar-gym", "compare-thesis", "--networks", args.networks.name, "--out", args.out.name]
    for f in fields(args):
        value = getattr(args, f.name)
        if f.name not in ("networks", "out", "page") and value != f.default:
            words += [f"--{f.name}", str(value)]
    return f"Made by `{shlex.join(words)}` at commit {commit()}."
