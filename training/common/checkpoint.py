"""A training that can be killed: weights, optimiser and history in one safetensors file. Nothing is ever unpickled."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from stable_baselines3.common.policies import ActorCriticPolicy

from acquisition import ModelError, SettingError
from acquisition.io.files import write_bytes

POLICY, ADAM, STATE = "policy.", "adam.", "state"


def save_checkpoint(path: Path, policy: ActorCriticPolicy, state: Mapping[str, Any]) -> None:
    """Write a checkpoint, whole or not at all.

    Args:
        path: of the file.
        policy: whose weights and optimiser are kept.
        state: plain data: settings, what is done, history.
    """
    tensors = {POLICY + name: value for name, value in policy.state_dict().items()}
    for number, moments in policy.optimizer.state_dict()["state"].items():
        tensors |= {f"{ADAM}{number}.{name}": value for name, value in moments.items()}
    whole = {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()}
    write_bytes(path, save(whole, metadata={STATE: json.dumps(dict(state), allow_nan=False)}))


def read_state(path: Path) -> dict[str, Any]:
    """Return the plain data of a checkpoint.

    Raises:
        ModelError: it is damaged, or something else.
    """
    try:
        with safe_open(path, "pt") as file:
            return dict(json.loads(file.metadata()[STATE]))
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise ModelError(f"{path}: cannot be read as a checkpoint ({error}); begin anew in another folder") from None


def load_checkpoint(path: Path, policy: ActorCriticPolicy) -> dict[str, Any]:
    """Put weights and optimiser of a checkpoint into a policy; returns its plain data."""
    state = read_state(path)
    with safe_open(path, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
    policy.load_state_dict({name.removeprefix(POLICY): v for name, v in tensors.items() if name.startswith(POLICY)})
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith(ADAM):
            number, key = name.removeprefix(ADAM).split(".")
            moments.setdefault(int(number), {})[key] = value
    adam = policy.optimizer.state_dict()
    policy.optimizer.load_state_dict({"state": moments, "param_groups": adam["param_groups"]})
    return state


def check_same(path: Path, now: Mapping[str, Any], before: Mapping[str, Any]) -> None:
    """Make sure that a training goes on with the settings that it was begun with.

    Raises:
        SettingError: one differs; the message names it.
    """
    for name, value in now.items():
        if before.get(name) != value:
            raise SettingError(
                f"{path.parent}: was begun with {name} = {before.get(name)}, not {value}: "
                "go on with the same settings, or give another --out"
            )
