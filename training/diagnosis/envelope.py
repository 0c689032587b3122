"""Concealed effects: each is described and hashed before the recording, and published after the diagnosis."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from acquisition.bench import Setup
from acquisition.io.files import write_bytes

Change = Callable[[Setup, np.random.Generator], tuple[Setup, str]]


def _warm_hall(setup: Setup, rng: np.random.Generator) -> tuple[Setup, str]:
    celsius = round(rng.uniform(29.0, 36.0), 1)
    return replace(setup, temperature_c=celsius), f"the air was at {celsius} degC instead of {setup.temperature_c} degC"


def _moved_zero(setup: Setup, rng: np.random.Generator) -> tuple[Setup, str]:
    metres = round(rng.uniform(0.02, 0.04), 3)
    return replace(setup, zero_m=metres), f"the sensor stood {1000 * metres:.0f} mm behind the mark"


def _dropped(setup: Setup, rng: np.random.Generator) -> tuple[Setup, str]:
    share = round(rng.uniform(0.08, 0.15), 2)
    return replace(
        setup, bus=replace(setup.bus, dropped=share)
    ), f"{100 * share:.0f} % of readings were lost on the bus"


CONCEALED: dict[str, Change] = {"sound_speed": _warm_hall, "zero_offset": _moved_zero, "dropped_reading": _dropped}


@dataclass(frozen=True)
class Envelope:
    """Description of a concealed effect.

    Attributes:
        effect: effect id.
        description: description in plain English.
        salt: random text, so that the hash cannot be guessed.
    """

    effect: str
    description: str
    salt: str

    @property
    def content(self) -> str:
        """Content of the file, as JSON."""
        named = {"effect": self.effect, "description": self.description, "salt": self.salt}
        return json.dumps(named, sort_keys=True) + "\n"

    @property
    def seal(self) -> str:
        """SHA-256 of the file, which proves afterwards that it was not changed."""
        return hashlib.sha256(self.content.encode()).hexdigest()

    def save(self, path: Path) -> None:
        """Write the content to a file."""
        write_bytes(path, self.content.encode())


def conceal(setup: Setup, rng: np.random.Generator, effect: str | None = None) -> tuple[Setup, Envelope]:
    """Return the setup changed by one effect, drawn by default, and its description."""
    name = effect or str(rng.choice(list(CONCEALED)))
    changed, description = CONCEALED[name](setup, rng)
    return changed, Envelope(name, description, rng.bytes(16).hex())
