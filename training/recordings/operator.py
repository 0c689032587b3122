"""Dialogue of a survey with an operator, who moves the reflector and checks sensor and wires."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rich.console import Console
from rich.progress import Progress

from acquisition import NoAnswerError
from acquisition.survey.plan import Condition
from acquisition.survey.quantities import QUANTITIES
from acquisition.survey.session import Answer

KEYS: Mapping[str, Answer] = {"": Answer.GO, "s": Answer.SKIP, "r": Answer.REPEAT, "q": Answer.QUIT}
TOLERANCE = 1e-9  # of equal values


@dataclass(frozen=True)
class TerminalOperator:
    """An operator at a terminal.

    Attributes:
        terminal: terminal for questions.
        bar: progress bar, stopped during a question.
    """

    terminal: Console
    bar: Progress

    def ready(self, before: Condition | None, condition: Condition, can_repeat: bool) -> Answer:
        """Ask for the changes that are made by hand; without any, return GO."""
        moves = changes(before, condition)
        if not moves:
            return Answer.GO
        again = {"r": "r repeat the previous one"} if can_repeat else {}
        return self._ask("\n".join(moves), {"": "Enter measure", "s": "s postpone", **again, "q": "q quit"})

    def unanswered(self, error: NoAnswerError) -> Answer:
        """Report the failed connection, and ask for a repair."""
        text = f"NO ANSWER. {error}. This condition is not recorded."
        return self._ask(text, {"": "Enter try again", "s": "s postpone", "q": "q quit"})

    def silent(self, conditions: int) -> Answer:
        """Ask for a hand in front of the sonar, to distinguish a defective sonar from an empty room."""
        since = f"in {conditions} consecutive conditions" if conditions else "in the first pings"
        text = f"The sonar answers but receives no echo {since}. Hold a hand 20 to 50 cm in front of it."
        return self._ask(text, {"": "Enter test", "s": "s no echo is correct here", "q": "q quit"})

    def _ask(self, text: str, keys: Mapping[str, str]) -> Answer:
        """Ask until one of the keys is given; the end of input means QUIT."""
        self.bar.stop()
        try:
            while True:
                self.terminal.print(text, markup=False, highlight=False)
                given = self.terminal.input(f"  [{', '.join(keys.values())}] ", markup=False).strip().lower()
                if given in keys:
                    return KEYS[given]
                self.terminal.print(f"  {given!r} is not one of these keys.", markup=False, highlight=False)
        except EOFError:
            return Answer.QUIT
        finally:
            self.bar.start()


def changes(before: Condition | None, condition: Condition) -> list[str]:
    """Return a line for each quantity that is changed by hand between two conditions; for the first one, all.

    >>> changes(Condition(500, 0, 0.9, 0), Condition(750, 0, 0.9, 0))
    ['Move: distance 500 mm -> 750 mm']
    >>> changes(Condition(500, 0, 0.9, 0, (("gain", 3),)), Condition(500, 0, 0.9, 0, (("gain", 4),)))
    []
    """
    if before is None:
        return [
            f"Set up: {QUANTITIES[name].label} {QUANTITIES[name].text(value)}"
            for name, value in condition.manual_values.items()
        ]
    return [
        f"Move: {QUANTITIES[name].label} {QUANTITIES[name].text(before.values[name])} -> {QUANTITIES[name].text(value)}"
        for name, value in condition.manual_values.items()
        if abs(value - before.values[name]) > TOLERANCE
    ]
