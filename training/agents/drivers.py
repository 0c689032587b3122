"""Drivers by their names.

"scripted", the name or folder of an agent, the file of a model of Stable-Baselines3 (`model.zip`), or
`module:callable`, a function from the number of cars to a `DriverPool`, as `training.agents.evaluate:ScriptedPool`.
"""

from __future__ import annotations

import importlib
import io
import json
import os
import sys
import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

import sonar_gym
from acquisition import ModelError, SettingError
from acquisition.arrays import Ints, Singles
from acquisition.limits import Loadable, shown
from sonar_gym.agent import DESCRIPTION, WEIGHTS, agent_names, load_policy
from sonar_gym.parking.fleet import Observation
from sonar_gym.sb3 import SonarVecEnv
from training.agents.evaluate import SCRIPTED, DriverPool, pool_of
from training.agents.zoo.settings import ALGORITHMS, CLASSES
from training.common.checksum import sha256_of_files

MAX_MEMBER, MAX_WIDTH = 2**28, 4096  # bytes of a part of a model's file, and units of a layer
PICKLED = ":serialized:"  # key under which Stable-Baselines3 stores pickled data; it is never read here
SHOWN = {str(one): one for one in CLASSES.values()}  # classes that a model may name


class ModelPool:
    """Cars driven by a model of Stable-Baselines3 without exploration; one with a recurrent policy has a state per car.

    Args:
        model: the model.
        count: number of cars.
    """

    def __init__(self, model: BaseAlgorithm, count: int) -> None:
        self._model, self._begins = model, np.ones(count, dtype=np.bool_)
        self._state: tuple[np.ndarray[Any, Any], ...] | None = None

    def reset(self, rows: Ints) -> None:
        """Begin new episodes with some cars."""
        self._begins[rows] = True

    def act(self, observation: Observation, rows: Ints) -> Singles:
        """Return an action for each of some cars, (r, 2)."""
        state = None if self._state is None else tuple(part[:, rows] for part in self._state)
        actions, after = self._model.predict(observation, state, self._begins[rows], deterministic=True)
        if after is not None:
            self._keep(after, rows)
        self._begins[rows] = False
        return np.asarray(actions, dtype=np.float32)

    def _keep(self, state: tuple[np.ndarray[Any, Any], ...], rows: Ints) -> None:
        if self._state is None:
            shapes = [(part.shape[0], len(self._begins), *part.shape[2:]) for part in state]
            self._state = tuple(np.zeros(shape, dtype=np.float32) for shape in shapes)
        for whole, part in zip(self._state, state, strict=True):
            whole[:, rows] = part


def load_zip(path: Path, algorithm: str) -> BaseAlgorithm:
    """Return a model from its file, without reading the pickled data in it.

    Args:
        path: of the file.
        algorithm: name of the algorithm, a key of the zoo's.

    Raises:
        ModelError: the file holds no such model for the parking environments.
    """
    kind: Any = ALGORITHMS[algorithm]
    keywords, weights = _parts(path)
    alias = next(name for name in kind.policy_aliases if name.startswith("MultiInput"))
    memory = {"buffer_size": 1} if issubclass(kind, OffPolicyAlgorithm) else {}
    try:
        model: BaseAlgorithm = kind(alias, SonarVecEnv(1, threads=1), policy_kwargs=keywords, device="cpu", **memory)
    except Exception as error:  # wrong keywords fail in many ways
        raise ModelError(
            f"{path}: its policy_kwargs are not those of {algorithm} ({error}); check --algorithm"
        ) from None
    try:
        model.policy.load_state_dict(weights)
    except (AttributeError, RuntimeError, TypeError, ValueError):
        raise ModelError(
            f"{path}: its networks are not those of {algorithm} for the observations of {sonar_gym.ENV_ID}; "
            "check --algorithm"
        ) from None
    return model


def _parts(path: Path) -> tuple[dict[str, Any], Mapping[str, Any]]:
    """Return the keywords of the policy and its weights, from the file of a model."""
    try:
        with zipfile.ZipFile(path) as archive:
            keywords = dict(json.loads(_member(archive, "data"))["policy_kwargs"])
            _check_widths(keywords)
            weights = torch.load(io.BytesIO(_member(archive, "policy.pth")), map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged file fails in many ways
        raise ModelError(f"{path}: is no model of Stable-Baselines3 ({type(error).__name__}: {error})") from None
    if PICKLED in keywords:  # the text of each value stands beside the pickled data
        given = {name: SHOWN.get(str(value), value) for name, value in keywords.items() if not name.startswith(":")}
        if any(isinstance(value, str) for value in given.values()):
            raise ModelError(f"{path}: its policy_kwargs are pickled, which is not read: score it as module:callable")
        keywords = given
    return keywords, weights


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    size = archive.getinfo(name).file_size
    if size > MAX_MEMBER:
        raise ValueError(f"{name} has {size} bytes, expected at most {MAX_MEMBER}")
    return archive.read(name)


def _check_widths(value: Any) -> None:
    """Raise ValueError for a whole number in nested lists and dictionaries that no width of a layer should be."""
    if isinstance(value, int) and value > MAX_WIDTH:
        raise ValueError(f"policy_kwargs name a width of {shown(value)}, expected at most {MAX_WIDTH}")
    if isinstance(value, list | dict):
        for part in value.values() if isinstance(value, dict) else value:
            _check_widths(part)


def _function(name: str) -> Callable[[int], DriverPool]:
    """Return a function by `module:callable`; modules of the current folder are found."""
    module, _, attribute = name.partition(":")
    sys.path.insert(0, os.getcwd())
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (Exception, SystemExit) as error:  # of the user's module
        reason = f"{type(error).__name__}: {error}"
        raise SettingError(f"driver {name!r}: cannot be imported ({reason}); give module:callable") from None
    finally:
        sys.path.pop(0)
    if not callable(found):
        raise SettingError(f"driver {name!r}: is a {type(found).__name__}, expected a function of the number of cars")
    return found


def _made(name: str, function: Callable[[int], DriverPool], count: int) -> DriverPool:
    """Return what a user's function makes for a number of cars."""
    try:
        pool = function(count)
    except (Exception, SystemExit) as error:
        raise SettingError(f"driver {name!r}: fails for {count} cars ({type(error).__name__}: {error})") from None
    if not (hasattr(pool, "reset") and hasattr(pool, "act")):
        raise SettingError(f"driver {name!r}: makes a {type(pool).__name__}, expected a pool with reset and act")
    return pool


def check_driver(name: str) -> None:
    """Raise SonarError where a name is that of no driver."""
    if name == SCRIPTED:
        return
    if ":" in name:
        _function(name)
    elif not name.endswith(".zip"):
        load_policy(name)
    elif not zipfile.is_zipfile(name):
        raise SettingError(f"{name}: is no file of a model")


def pool_by_name(name: str, algorithm: str) -> Callable[[int], DriverPool]:
    """Return a function from the number of cars to a pool of drivers.

    Args:
        name: see the module.
        algorithm: of a model of Stable-Baselines3.
    """
    if name == SCRIPTED:
        return pool_of(SCRIPTED)
    if ":" in name:
        return partial(_made, name, _function(name))
    if name.endswith(".zip"):
        model = load_zip(Path(name), algorithm)
        return lambda count: ModelPool(model, count)
    return pool_of(load_policy(name))


def digest_of(name: str) -> str:
    """Return the SHA-256 of the files that a driver consists of."""
    if name == SCRIPTED:
        return sha256_of_files(sorted((Path(sonar_gym.__file__).parent / "control").glob("*.py")))
    if ":" in name:
        source = getattr(sys.modules[name.partition(":")[0]], "__file__", None)
        return sha256_of_files([] if source is None else [Path(source)])
    if name.endswith(".zip"):
        return sha256_of_files([Path(name)])
    folder = WEIGHTS / name if name in agent_names() else Path(name)
    return sha256_of_files([folder / DESCRIPTION, folder / "weights.safetensors"])


Driver = Annotated[str, Loadable(check_driver)]
