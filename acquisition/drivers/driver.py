"""The protocol of a sonar driver, and the answer to a ping."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Echoes:
    """The answer to one ping.

    Attributes:
        ranges: reported ranges of the echoes, m, in ascending order; empty without an echo.
        light: value of the light sensor, 0..255; None without a light sensor.
    """

    ranges: tuple[float, ...]
    light: int | None = None


class SonarDriver(Protocol):
    """Driver of one sonar."""

    def ping(self) -> Echoes:
        """Fire once and return the echoes.

        Raises:
            NoAnswerError: the device did not answer in time, which is not the same as no echo.
        """
