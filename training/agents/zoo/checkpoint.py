"""Checkpoints of a learner of Stable-Baselines3 in one safetensors file: networks, optimisers, replay buffer, counters.

Every learner names its networks and optimisers in `get_parameters`. Tensors of them are stored by their place in these
nested dictionaries; everything else in them follows from the settings and is taken from the fresh learner.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file, save
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.save_util import recursive_getattr

from acquisition.io.files import write_bytes
from sonar_gym.curriculum import Curriculum
from training.common.checkpoint import STATE, valid_checkpoint

PARAMETERS, BUFFER, GAP = "parameters", "buffer", "/"
Tensors = dict[str, torch.Tensor]


def save_learner(path: Path, model: BaseAlgorithm, callbacks: Sequence[Any], state: Mapping[str, Any]) -> None:
    """Write a checkpoint atomically.

    Args:
        path: file to write.
        model: the learner.
        callbacks: of its training; the state of a curriculum is stored.
        state: plain data: settings, progress.
    """
    tensors = dict(_tensors(PARAMETERS, model.get_parameters())) | _variables(model) | _buffer(model)
    whole = {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()}
    counters = {"steps": model.num_timesteps, "updates": getattr(model, "_n_updates", 0)}
    curricula = [one.state_dict() for one in callbacks if isinstance(one, Curriculum)]
    content = {**state, **counters, "curricula": curricula}
    write_bytes(path, save(whole, metadata={STATE: json.dumps(content, allow_nan=False)}))


def load_learner(path: Path, model: BaseAlgorithm, callbacks: Sequence[Any], state: Mapping[str, Any]) -> None:
    """Load a checkpoint into a fresh learner and its callbacks.

    Args:
        path: of the checkpoint.
        model: learner with the same settings.
        callbacks: of its training.
        state: plain data of the checkpoint (`read_state`).

    Raises:
        ModelError: the file is not a valid checkpoint of such a learner.
    """
    with valid_checkpoint(path):
        tensors = load_file(path)
        model.set_parameters(_replaced(PARAMETERS, model.get_parameters(), tensors), exact_match=True, device="cpu")
        model.num_timesteps, model._n_updates = int(state["steps"]), int(state["updates"])
        for name, value in _variables(model).items():
            value.data.copy_(tensors[name])
        _fill(model, tensors)
        curricula = [one for one in callbacks if isinstance(one, Curriculum)]
        for one, stored in zip(curricula, state["curricula"], strict=True):
            one.load_state_dict(stored)


def _tensors(name: str, value: Any) -> Iterator[tuple[str, torch.Tensor]]:
    """Yield the tensors of nested dictionaries by their places."""
    if isinstance(value, torch.Tensor):
        yield name, value
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _tensors(f"{name}{GAP}{key}", inner)


def _replaced(name: str, value: Any, tensors: Tensors) -> Any:
    """Return nested dictionaries with the stored tensors; of an optimiser, whose moments appear later, all of them."""
    if isinstance(value, torch.Tensor):
        return tensors[name]
    if not isinstance(value, Mapping):
        return value
    inner = {key: _replaced(f"{name}{GAP}{key}", one, tensors) for key, one in value.items()}
    return inner | {"state": _moments(f"{name}{GAP}state{GAP}", tensors)} if "param_groups" in inner else inner


def _moments(start: str, tensors: Tensors) -> dict[int, Tensors]:
    """Return the moments of an optimiser by number of the parameter and name."""
    out: dict[int, Tensors] = {}
    for name, value in tensors.items():
        if name.startswith(start):
            number, key = name.removeprefix(start).split(GAP)
            out.setdefault(int(number), {})[key] = value
    return out


def _variables(model: BaseAlgorithm) -> Tensors:
    """Return the trained tensors that are parts of no network, such as the logarithm of SAC's entropy coefficient."""
    names = model._get_torch_save_params()[1]
    return {f"{PARAMETERS}{GAP}{GAP}{name}": recursive_getattr(model, name) for name in names}


# ---- the replay buffer -----------------------------------------------------------------------------------------------


def _arrays(buffer: BaseBuffer) -> dict[str, np.ndarray[Any, Any]]:
    """Return the arrays of numbers of a replay buffer, which it fills row by row, and those of its episodes."""
    out: dict[str, np.ndarray[Any, Any]] = {}
    for name, value in vars(buffer).items():
        parts = value.items() if isinstance(value, Mapping) else [("", value)]
        out |= {f"{name}{GAP}{key}": v for key, v in parts if isinstance(v, np.ndarray) and v.dtype != object}
    return out


def _buffer(model: BaseAlgorithm) -> Tensors:
    buffer = getattr(model, "replay_buffer", None)
    if buffer is None:
        return {}
    rows = buffer.buffer_size if buffer.full else buffer.pos
    out = {f"{BUFFER}{GAP}{name}": torch.from_numpy(_used(v, buffer, rows)) for name, v in _arrays(buffer).items()}
    return out | {BUFFER: torch.tensor([buffer.pos, int(buffer.full)])}


def _used(value: np.ndarray[Any, Any], buffer: BaseBuffer, rows: int) -> np.ndarray[Any, Any]:
    return value[:rows] if len(value) == buffer.buffer_size else value


def _fill(model: BaseAlgorithm, tensors: Tensors) -> None:
    buffer = getattr(model, "replay_buffer", None)
    if buffer is None:
        return
    buffer.pos, buffer.full = int(tensors[BUFFER][0]), bool(tensors[BUFFER][1])
    for name, value in _arrays(buffer).items():
        stored = tensors[f"{BUFFER}{GAP}{name}"].numpy()
        value[: len(stored)] = stored
