"""Trained parking agents: feed-forward policies over an observation memory, evaluated with NumPy alone."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from acquisition import ModelError, UnknownModelError
from acquisition.arguments import checked
from acquisition.arrays import Ints, Singles
from acquisition.io.files import is_folder, whole_folder
from acquisition.io.schema import Schema, read_json
from acquisition.limits import Limit, near
from noise.learned.tensors import layers_of, read_tensors, shapes_of, tensors_of, write_tensors
from noise.schema import Sizes
from sonar_gym.checks import check_observation
from sonar_gym.control.memory import EGO, MemorySettings, Observation, ObservationMemory

Layer = tuple[Singles, Singles]
FORMAT = 1
KIND = "parking-agent"
WEIGHTS = Path(__file__).parent / "weights"
DESCRIPTION = "agent.json"
ACTIONS = 2
ONE = np.zeros(1, dtype=np.int64)  # row index of a single car


class MemorySchema(Schema):
    """Schema of the settings of the observation memory."""

    lags: Annotated[int, Limit(1, 64)]
    behind: Annotated[float, Limit(0.0, 5.0, "m")]
    ahead: Annotated[float, Limit(0.0, 5.0, "m")]
    coarse: Annotated[int, Limit(1, 1024)]
    credence: bool
    echo: bool = True


class AgentSchema(Schema):
    """Schema of agent.json."""

    format: Literal[1]
    kind: Literal["parking-agent"]
    sizes: Sizes
    repeat: Annotated[int, Limit(1, 1000)]
    memory: MemorySchema
    about: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Policy:
    """Multilayer perceptron with tanh activations, from the features of an observation memory to an action.

    Attributes:
        layers: weights (out, in) and biases (out,) of each layer, float32.
        memory: settings of the observation memory.
        repeat: number of 0.1 s steps for which an action is repeated.
        about: training record, JSON data.
        card: text of the folder's README.md.
    """

    layers: Sequence[Layer]
    memory: MemorySettings
    repeat: int = 1
    about: Mapping[str, Any] = field(default_factory=dict)
    card: str = ""

    def __post_init__(self) -> None:
        """Raise ModelError if the layers do not map the features to an action."""
        sizes, features = self.sizes, ObservationMemory(1, settings=self.memory).size
        fit = all(weight.shape[0] == len(bias) for weight, bias in self.layers)
        chained = all(a[0].shape[0] == b[0].shape[1] for a, b in zip(self.layers, self.layers[1:], strict=False))
        if not (fit and chained) or sizes[0] != features or sizes[-1] != ACTIONS or self.repeat < 1:
            raise ModelError(f"agent: layers {sizes} do not map {features} features to {ACTIONS} actions; retrain it")

    @property
    def sizes(self) -> list[int]:
        """Widths of all layers, beginning with the input."""
        return [self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers)]

    @cached_property
    def _transposed(self) -> list[Layer]:
        return [(np.ascontiguousarray(weight.T), bias) for weight, bias in self.layers]

    def act(self, features: Singles) -> Singles:
        """Return actions within -1..1, (n, 2), for features (n, size)."""
        x = features
        for weight, bias in self._transposed[:-1]:
            x = np.tanh(x @ weight + bias)
        weight, bias = self._transposed[-1]
        return np.clip(x @ weight + bias, -1.0, 1.0)

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write agent.json, weights.safetensors and README.md atomically, and return the folder."""
        folder = Path(folder)
        if folder.exists() and not (folder / DESCRIPTION).is_file() and (folder.is_file() or any(folder.iterdir())):
            raise ModelError(f"{folder}: exists and is not an agent; give the name of a new folder")
        with whole_folder(folder) as fresh:
            self._write(fresh)
        return folder

    def _write(self, folder: Path) -> None:
        description = {
            "format": FORMAT,
            "kind": KIND,
            "sizes": self.sizes,
            "repeat": self.repeat,
            "memory": self.memory.to_dict(),
            "about": dict(self.about),
        }
        text = json.dumps(description, indent=2, allow_nan=False) + "\n"
        (folder / DESCRIPTION).write_text(text, encoding="utf-8")
        write_tensors(folder, tensors_of(self.layers), self.card)

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> Policy:
        """Read the folder of a saved agent.

        Raises:
            ModelError: the folder is damaged or does not contain an agent.
        """
        folder = Path(folder)
        description = read_json(folder / DESCRIPTION, AgentSchema)
        memory, repeat, sizes = MemorySettings(**description["memory"]), description["repeat"], description["sizes"]
        tensors, card = read_tensors(folder, shapes_of(sizes))
        return cls(layers_of(tensors, len(sizes) - 1), memory, repeat, description.get("about", {}), card)


class VectorAgent:
    """One policy that drives n cars, each with its own observation memory.

    Args:
        policy: the policy.
        count: number of cars.
    """

    def __init__(self, policy: Policy, count: int) -> None:
        self.policy, self.count = policy, count
        self.memory = ObservationMemory(count, settings=policy.memory)
        self._action = np.zeros((count, ACTIONS), dtype=np.float32)
        self._age = np.zeros(count, dtype=np.int64)

    def reset(self, rows: Ints) -> None:
        """Begin the episodes of some cars."""
        self.memory.reset(rows)
        self._age[rows] = 0

    def act(self, observation: Observation, rows: Ints | None = None) -> Singles:
        """Return the actions of some cars, or of all, (r, 2), from their observations."""
        rows = np.arange(self.count) if rows is None else rows
        self.memory.update(rows, observation)
        due = rows[self._age[rows] % self.policy.repeat == 0]
        if len(due):
            self._action[due] = self.policy.act(self.memory.features(due))
        self._age[rows] += 1
        return self._action[rows]


class AgentDriver:
    """Controller of one car by a policy, for `run_episode`."""

    def __init__(self, policy: Policy) -> None:
        self._agent = VectorAgent(policy, 1)

    def reset(self) -> None:
        """Begin an episode."""
        self._agent.reset(ONE)

    def act(self, observation: Observation) -> Singles:
        """Return the steering and speed setpoints as fractions of their maxima, (2,)."""
        sonars = (self._agent.memory.sonars,)
        check_observation(observation, {"ego": (EGO,), **dict.fromkeys(("ranges", "echo", "credence"), sonars)})
        return self._agent.act({name: np.asarray(value)[None] for name, value in observation.items()}, ONE)[0]


def drive_by_agent(count: int, policy: Policy | None = None) -> Callable[[Observation, Ints], Singles]:
    """Return a driver of n cars by one policy, the shipped one by default: `act(observation, begun)`."""
    agent = VectorAgent(load_policy("parking") if policy is None else policy, count)

    def act(observation: Observation, begun: Ints) -> Singles:
        agent.reset(begun)
        return agent.act(observation)

    return act


def agent_names() -> list[str]:
    """Return the names of the shipped agents."""
    return sorted(path.parent.name for path in WEIGHTS.glob(f"*/{DESCRIPTION}"))


@checked
def load_policy(name: str | os.PathLike[str]) -> Policy:
    """Return the policy of a shipped agent, by name, or of a saved agent, by folder.

    Raises:
        UnknownModelError: `name` is neither a shipped agent nor a folder.
        ModelError: the folder does not contain an agent that this version can read.
    """
    folder = WEIGHTS / str(name) if str(name) in agent_names() else Path(name)
    if not is_folder(folder):
        hint = near(name, agent_names()) or f"; known names: {', '.join(agent_names())}"
        raise UnknownModelError(f"agent {str(name)!r}: no such name or folder{hint}")
    return Policy.load(folder)


def load_agent(name: str | os.PathLike[str] = "parking") -> AgentDriver:
    """Return the controller of a shipped agent, by name, or of a saved agent, by folder."""
    return AgentDriver(load_policy(name))
