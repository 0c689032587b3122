"""One kind of progress bar for every command: on stderr, gone when done, nothing where stderr is no terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

TERMINAL = Console(stderr=True)


def bars() -> Progress:
    """Return bars with count and time left, to be entered with `with`."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=TERMINAL, transient=True, disable=not TERMINAL.is_terminal)


@contextmanager
def bar(what: str, total: int) -> Iterator[Callable[[int, int], None]]:
    """Show the progress of one thing; yields a function of how much is done, and of how much there is in all.

    Args:
        what: is being done.
        total: number of steps, as far as it is known now.
    """
    with bars() as progress:
        task = progress.add_task(what, total=total)
        yield lambda done, of: progress.update(task, completed=done, total=of)
