"""Progress bars on stderr, removed when done, and disabled if stderr is not a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

TERMINAL = Console(stderr=True)
OnProgress = Callable[[str, int, int], None]  # name of the task, steps done, steps in total


def bars() -> Progress:
    """Return progress bars with count and remaining time, as a context manager."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=TERMINAL, transient=True, disable=not TERMINAL.is_terminal)


@contextmanager
def bar(task_name: str, total: int) -> Iterator[Callable[[int, int], None]]:
    """Show one progress bar; yields a function (done, total) that updates it.

    Args:
        task_name: text beside the bar.
        total: number of steps, if known approximately.
    """
    with bars() as progress:
        task = progress.add_task(task_name, total=total)
        yield lambda done, total: progress.update(task, completed=done, total=total)


@contextmanager
def progress_bars() -> Iterator[OnProgress]:
    """Show one progress bar per task name; yields the function that updates them."""
    with bars() as progress:
        tasks: dict[str, TaskID] = {}

        def on_progress(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = progress.add_task(name, total=total)
            progress.update(tasks[name], completed=done, total=total)

        yield on_progress
