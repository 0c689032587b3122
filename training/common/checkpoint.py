"""Checkpoints of a training: weights, optimiser and history in one safetensors file, without pickle."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
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
    """Write a checkpoint atomically.

    Args:
        path: file to write.
        policy: policy with its optimiser.
        state: plain data: settings, progress, history.
    """
    tensors = {POLICY + name: value for name, value in policy.state_dict().items()}
    for number, moments in policy.optimizer.state_dict()["state"].items():
        tensors |= {f"{ADAM}{number}.{name}": value for name, value in moments.items()}
    whole = {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()}
    write_bytes(path, save(whole, metadata={STATE: json.dumps(dict(state), allow_nan=False)}))


@contextmanager
def valid_checkpoint(path: Path) -> Iterator[None]:
    """Raise ModelError where a block finds that the file is not a valid checkpoint."""
    try:
        if not path.is_file():  # a pipe would block
            raise OSError("it is no file on a disk")
        yield
    except (SafetensorError, OSError, AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ModelError(f"{path}: is not a valid checkpoint ({reason}); start again in another folder") from None


def read_state(path: Path) -> dict[str, Any]:
    """Return the plain data of a checkpoint.

    Raises:
        ModelError: the file is not a valid checkpoint.
    """
    with valid_checkpoint(path), safe_open(path, "pt") as file:
        state = dict(json.loads(file.metadata()[STATE]))
        state["settings"] = dict(state["settings"])
        return state


def load_checkpoint(path: Path, policy: ActorCriticPolicy) -> dict[str, Any]:
    """Load weights and optimiser state into a policy, and return the plain data.

    Raises:
        ModelError: the file is not a valid checkpoint of such a policy.
    """
    state = read_state(path)
    with valid_checkpoint(path):
        _load(path, policy)
    return state


def _load(path: Path, policy: ActorCriticPolicy) -> None:
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


def check_same(path: Path, now: Mapping[str, Any], before: Mapping[str, Any]) -> None:
    """Check that a resumed training has its original settings.

    Raises:
        SettingError: a setting differs.
    """
    for name, value in now.items():
        if before.get(name) != value:
            raise SettingError(
                f"{path.parent}: was started with {name} = {before.get(name)}, not {value}; "
                "use the same settings or another --out"
            )
