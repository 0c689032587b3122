"""What every driver of a sonar is, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Echoes:
    """The answer to one ping.

    Attributes:
        ranges: reported ranges of the echoes, m, nearest first; none where nothing was heard.
        light: of the light sensor, 0..255, where there is one.
    """

    ranges: tuple[float, ...]
    light: int | None = None


class Driver(Protocol):
    """A sonar that can be asked for a ping."""

    def ping(self) -> Echoes:
        """Fire once and return what was heard.

        Raises:
            NoAnswerError: the device did not answer in time; that is no silence.
        """
