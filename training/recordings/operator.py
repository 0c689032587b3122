"""The wizard of a survey: asks somebody to move the stand, and never takes a dead wire for silence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rich.console import Console
from rich.progress import Progress

from acquisition import NoAnswerError
from acquisition.survey.plan import Cell
from acquisition.survey.quantities import QUANTITIES
from acquisition.survey.session import Answer

KEYS: Mapping[str, Answer] = {"": Answer.GO, "s": Answer.SKIP, "r": Answer.REPEAT, "q": Answer.QUIT}
SMALL = 1e-9


@dataclass(frozen=True)
class Asking:
    """An operator at a terminal.

    Attributes:
        terminal: to ask on.
        bar: of progress; rests while a question stands, for it would write over it.
    """

    terminal: Console
    bar: Progress

    def ready(self, before: Cell | None, cell: Cell, can_repeat: bool) -> Answer:
        """Ask for what has to be moved by hand; where nothing has, go on unasked."""
        moves = changes(before, cell)
        if not moves:
            return Answer.GO
        again = {"r": "r the one before again"} if can_repeat else {}
        return self._ask("\n".join(moves), {"": "Enter measured from here", "s": "s later", **again, "q": "q stop"})

    def unanswered(self, error: NoAnswerError) -> Answer:
        """Show what the wire does, and ask whether it is mended."""
        text = f"NO ANSWER. {error}. This condition is not written down."
        return self._ask(text, {"": "Enter try again", "s": "s leave it for later", "q": "q stop"})

    def silent(self, cells: int) -> Answer:
        """Ask for a hand before the sonar, so that a deaf sonar is told from an empty room."""
        since = f"for {cells} conditions in a row" if cells else "in the first pings"
        text = f"The sonar answers but hears nothing {since}. Hold a hand 20 to 50 cm before it."
        return self._ask(text, {"": "Enter test", "s": "s silence is right here", "q": "q stop"})

    def _ask(self, text: str, keys: Mapping[str, str]) -> Answer:
        """Ask until one of the keys is given; the end of input means stop."""
        self.bar.stop()
        try:
            while True:
                self.terminal.print(text, markup=False, highlight=False)
                given = self.terminal.input(f"  [{', '.join(keys.values())}] ", markup=False).strip().lower()
                if given in keys:
                    return KEYS[given]
                self.terminal.print(f"  {given!r} is none of these.", markup=False, highlight=False)
        except EOFError:
            return Answer.QUIT
        finally:
            self.bar.start()


def changes(before: Cell | None, cell: Cell) -> list[str]:
    """Return a line for each quantity that somebody has to change by hand between two cells; for the first, all.

    >>> changes(Cell(500, 0, 0.9, 0), Cell(750, 0, 0.9, 0))
    ['Move: distance 500 mm -> 750 mm']
    >>> changes(Cell(500, 0, 0.9, 0, (("gain", 3),)), Cell(500, 0, 0.9, 0, (("gain", 4),)))
    []
    """
    if before is None:
        return [f"Set up: {QUANTITIES[name].what} {QUANTITIES[name].say(value)}" for name, value in cell.stand.items()]
    return [
        f"Move: {QUANTITIES[name].what} {QUANTITIES[name].say(before.values[name])} -> {QUANTITIES[name].say(value)}"
        for name, value in cell.stand.items()
        if abs(value - before.values[name]) > SMALL
    ]
