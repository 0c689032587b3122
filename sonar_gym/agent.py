"""A trained agent: a small network over its memory, run by numpy alone. `load_agent("parking")` parks."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition import ModelError, UnknownModelError
from acquisition.io.files import whole_folder
from noise.learned.tensors import layers_of, read_tensors, shapes_of, tensors_of, write_tensors
from sonar_gym.control.memory import Memory, MemorySettings

Singles = NDArray[np.float32]
Layer = tuple[Singles, Singles]
Observation = Mapping[str, NDArray[Any]]
FORMAT = 1
KIND = "parking-agent"
WEIGHTS = Path(__file__).parent / "weights"
DESCRIPTION = "agent.json"
ACTIONS = 2
ONE = np.zeros(1, dtype=np.int64)  # the rows of a memory of one


@dataclass(frozen=True, eq=False)
class Policy:
    """Actions from memories: a perceptron with tanh between its layers.

    Attributes:
        layers: weights (out, in) and biases (out,) of each, float32.
        memory: what it is shown.
        repeat: steps of 0.1 s for which an action holds.
        about: plain data on its making.
        card: text of the folder's README.md.
    """

    layers: Sequence[Layer]
    memory: MemorySettings
    repeat: int = 1
    about: Mapping[str, Any] = field(default_factory=dict)
    card: str = ""

    def __post_init__(self) -> None:
        """Refuse layers that do not lead from a memory to an action."""
        sizes, shown = self.sizes, Memory(1, settings=self.memory).size
        fit = all(weight.shape[0] == len(bias) for weight, bias in self.layers)
        chained = all(a[0].shape[0] == b[0].shape[1] for a, b in zip(self.layers, self.layers[1:], strict=False))
        if not (fit and chained) or sizes[0] != shown or sizes[-1] != ACTIONS or self.repeat < 1:
            raise ModelError(f"agent: layers {sizes} do not lead from {shown} numbers to {ACTIONS}; train it anew")

    @property
    def sizes(self) -> list[int]:
        """Widths of all layers, what it is shown first."""
        return [self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers)]

    @cached_property
    def _transposed(self) -> list[Layer]:
        return [(np.ascontiguousarray(weight.T), bias) for weight, bias in self.layers]

    def act(self, shown: Singles) -> Singles:
        """Return an action within -1..1 for each memory, (n, 2)."""
        x = shown
        for weight, bias in self._transposed[:-1]:
            x = np.tanh(x @ weight + bias)
        weight, bias = self._transposed[-1]
        return np.clip(x @ weight + bias, -1.0, 1.0)

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write agent.json, weights.safetensors and the card, whole or not at all; returns the folder."""
        folder = Path(folder)
        if folder.exists() and not (folder / DESCRIPTION).is_file() and (folder.is_file() or any(folder.iterdir())):
            raise ModelError(f"{folder}: holds something else than an agent; give the name of a new folder")
        with whole_folder(folder) as fresh:
            self._write(fresh)
        return folder

    def _write(self, folder: Path) -> None:
        said = {
            "format": FORMAT,
            "kind": KIND,
            "sizes": self.sizes,
            "repeat": self.repeat,
            "memory": self.memory.to_dict(),
            "about": dict(self.about),
        }
        (folder / DESCRIPTION).write_text(json.dumps(said, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        write_tensors(folder, tensors_of(self.layers), self.card)

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> Policy:
        """Read an agent's folder.

        Raises:
            ModelError: it is damaged, or something else.
        """
        folder = Path(folder)
        said = _described(folder / DESCRIPTION)
        try:
            memory, sizes, repeat = MemorySettings(**said["memory"]), list(map(int, said["sizes"])), int(said["repeat"])
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"{folder / DESCRIPTION}: does not describe an agent ({error}); train it anew") from None
        tensors, card = read_tensors(folder, shapes_of(sizes))
        return cls(layers_of(tensors, len(sizes) - 1), memory, repeat, said.get("about", {}), card)


def _described(path: Path) -> dict[str, Any]:
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ModelError(f"{path.parent}: holds no {DESCRIPTION}; give the folder of a saved agent") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: cannot be read as JSON ({error}); it is damaged") from None
    if not isinstance(said, dict) or said.get("format") != FORMAT or said.get("kind") != KIND:
        raise ModelError(f"{path}: is no agent of format {FORMAT}; it is of something else, or of another version")
    return said


class Agents:
    """One policy that drives n cars, each with a memory of its own.

    Args:
        policy: that acts.
        count: of cars.
    """

    def __init__(self, policy: Policy, count: int) -> None:
        self.policy, self.count = policy, count
        self.memory = Memory(count, settings=policy.memory)
        self._held = np.zeros((count, ACTIONS), dtype=np.float32)
        self._age = np.zeros(count, dtype=np.int64)

    def forget(self, rows: NDArray[np.int64]) -> None:
        """Begin episodes with some cars."""
        self.memory.forget(rows)
        self._age[rows] = 0

    def act(self, observation: Observation, rows: NDArray[np.int64] | None = None) -> Singles:
        """Return an action for each of some cars from what they observe, (r, 2); for all where none are named."""
        rows = np.arange(self.count) if rows is None else rows
        self.memory.see(rows, observation)
        due = rows[self._age[rows] % self.policy.repeat == 0]
        if len(due):
            self._held[due] = self.policy.act(self.memory.show(due))
        self._age[rows] += 1
        return self._held[rows]


class AgentDriver:
    """A policy as the driver of one car, for `run_episode`."""

    def __init__(self, policy: Policy) -> None:
        self._agents = Agents(policy, 1)

    def reset(self) -> None:
        """Forget the last episode."""
        self._agents.forget(ONE)

    def act(self, observation: Observation) -> Singles:
        """Return steering and speed wanted, as shares of the greatest, (2,)."""
        return self._agents.act({name: value[None] for name, value in observation.items()}, ONE)[0]


def agent_names() -> list[str]:
    """Return the names that `load_agent` knows."""
    return sorted(path.parent.name for path in WEIGHTS.glob(f"*/{DESCRIPTION}"))


def load_policy(name: str | os.PathLike[str]) -> Policy:
    """Return a policy by the name of a shipped one, or by the path of its folder.

    Raises:
        UnknownModelError: neither a known name nor a folder.
        ModelError: the folder does not hold an agent that this version can read.
    """
    shipped = WEIGHTS / str(name)
    folder = shipped if (shipped / DESCRIPTION).is_file() else Path(name)
    if not folder.is_dir():
        raise UnknownModelError(f"agent {str(name)!r}: no such name or folder; known names: {', '.join(agent_names())}")
    return Policy.load(folder)


def load_agent(name: str | os.PathLike[str] = "parking") -> AgentDriver:
    """Return a driver by the name of a shipped agent, or by the path of its folder."""
    return AgentDriver(load_policy(name))
