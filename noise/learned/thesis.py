"""The networks published with the thesis (Esmi 2016), read from their Keras 1 files.

They map a reading back to the distance of the reflector, so they are not laws and cannot be sampled; they are the only
public result of the real recordings. There are two kinds: an MLP (25 sigmoids, dropout, a sigmoid) and an LSTM (the
four inputs as a sequence of scalars, 25 cells, dropout, a linear output).

Inputs are scaled as in the thesis: angle / 45 deg, reflectance, reading / 6000 mm and credence; an output y is a
distance of 5970 y + 30 mm (table 4.1: 3900 mm is 0.6482, and a reading of 3950 mm is 0.6583). Two files of each kind
are published: `*_weights.hdf5` with the best validation error, `*_my_model.h5` of the last epoch. The files are not
part of this project. The HDF5 library can crash on damaged files, so read only files from a known source.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition import ModelError
from acquisition.arguments import checked
from acquisition.arrays import Floats
from acquisition.io.files import is_file

Kind = Literal["mlp", "lstm"]
MAX_ANGLE = np.deg2rad(45.0)
MAX_READING = 6.0  # m
MIN_DISTANCE, MAX_DISTANCE = 0.030, 6.0  # m; distances of label 0 and label 1
MAX_FILE_BYTES = 1 << 20  # the published files have 17 and 61 kB
MAX_WIDTH = 1024  # neurons or cells
GATES = ("i", "f", "c", "o")  # input, forget, candidate, output, by their letters in Keras 1

# class and relevant settings of each layer, by kind
LAYERS: dict[Kind, tuple[tuple[str, dict[str, Any]], ...]] = {
    "mlp": (("Dense", {"activation": "sigmoid"}), ("Dropout", {}), ("Dense", {"activation": "sigmoid"})),
    "lstm": (
        ("LSTM", {"activation": "sigmoid", "inner_activation": "hard_sigmoid", "return_sequences": False}),
        ("Dropout", {}),
        ("Dense", {"activation": "linear"}),
    ),
}


def _sigmoid(x: Floats) -> Floats:
    return 0.5 * (1.0 + np.tanh(0.5 * x))


def _hard_sigmoid(x: Floats) -> Floats:
    return np.clip(0.2 * x + 0.5, 0.0, 1.0)


@dataclass(frozen=True)
class ThesisNetwork:
    """One of the published networks.

    Attributes:
        kind: "mlp" or "lstm".
        weights: arrays by their names in the file, float64.

    >>> flat = {"dense_1_W": np.zeros((4, 25)), "dense_1_b": np.zeros(25)}
    >>> network = ThesisNetwork("mlp", {**flat, "dense_2_W": np.zeros((25, 1)), "dense_2_b": np.zeros(1)})
    >>> network.distance(angle=0.0, reflectance=0.9, reading=[0.0, 3.0], credence=0.5)
    array([3.015, 3.015])
    """

    kind: Kind
    weights: Mapping[str, Floats]

    def distance(self, angle: ArrayLike, reflectance: ArrayLike, reading: ArrayLike, credence: ArrayLike) -> Floats:
        """Return the network's estimate of the distance, m, in the broadcast shape of the arguments.

        Args:
            angle: angle of the reflector, rad; trained on 0 to 45 deg.
            reflectance: 0.1 (rubber) or 0.9 (mirror); trained on these two values.
            reading: range reading, m; 0 for no echo, as in the thesis's tables.
            credence: share of the condition's readings within 10 % of its distance, 0..1.
        """
        scaled = (
            np.asarray(angle, dtype=np.float64) / MAX_ANGLE,
            np.asarray(reflectance, dtype=np.float64),
            np.asarray(reading, dtype=np.float64) / MAX_READING,
            np.asarray(credence, dtype=np.float64),
        )
        inputs = np.stack(np.broadcast_arrays(*scaled), axis=-1)
        label = self.output(inputs.reshape(-1, 4)).reshape(inputs.shape[:-1])
        return MIN_DISTANCE + (MAX_DISTANCE - MIN_DISTANCE) * label

    def output(self, inputs: NDArray[np.floating]) -> Floats:
        """Return the network's output for scaled inputs (n, 4), (n,)."""
        return self._mlp(inputs) if self.kind == "mlp" else self._lstm(inputs)

    def _mlp(self, inputs: NDArray[np.floating]) -> Floats:
        w = self.weights
        hidden = _sigmoid(inputs @ w["dense_1_W"] + w["dense_1_b"])
        return _sigmoid(hidden @ w["dense_2_W"] + w["dense_2_b"])[:, 0]

    def _lstm(self, inputs: NDArray[np.floating]) -> Floats:
        w = self.weights
        cell = hidden = np.zeros((len(inputs), len(w["lstm_1_b_i"])))
        for x in inputs.T[:, :, None]:
            drive = {g: x @ w[f"lstm_1_W_{g}"] + hidden @ w[f"lstm_1_U_{g}"] + w[f"lstm_1_b_{g}"] for g in GATES}
            retained, added = _hard_sigmoid(drive["f"]) * cell, _hard_sigmoid(drive["i"]) * _sigmoid(drive["c"])
            cell = retained + added
            hidden = _hard_sigmoid(drive["o"]) * _sigmoid(cell)
        return (hidden @ w["dense_1_W"] + w["dense_1_b"])[:, 0]


@checked
def load_thesis_network(path: str | os.PathLike[str]) -> ThesisNetwork:
    """Return a network from a file published with the thesis, `*_my_model.h5` or `*_weights.hdf5`.

    Raises:
        ModelError: the file is missing, damaged, or of another network.
    """
    path = Path(path)
    _check_file(path)
    try:
        with h5py.File(path, "r") as file:
            kind, width = _architecture(path, file)
            weights = {name: _array(path, file, name, shape) for name, shape in _shapes(kind, width).items()}
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"{path}: not a complete HDF5 file ({error}); download the file again") from None
    return ThesisNetwork(kind, weights)


def _check_file(path: Path) -> None:
    if not is_file(path):
        raise ModelError(f"{path}: no such file; give one of the networks published with the thesis")
    if path.stat().st_size > MAX_FILE_BYTES:
        raise ModelError(
            f"{path}: {path.stat().st_size} bytes, but the thesis's networks are under {MAX_FILE_BYTES} bytes"
        )


def _architecture(path: Path, file: h5py.File) -> tuple[Kind, int]:
    """Return the kind of network in a file, and its number of neurons or cells."""
    version, config = _text(file.attrs.get("keras_version", "")), _text(file.attrs.get("model_config", "{}"))
    if not version.startswith("1."):
        raise ModelError(f"{path}: of Keras {version or '(unknown)'}, expected 1.0.8: not one of the thesis's networks")
    found = _layers(path, config)
    for kind, expected in LAYERS.items():
        if len(found) == len(expected) and all(map(_is_as, found, expected)):
            width = found[0][1].get("output_dim")
            if isinstance(width, int) and 0 < width <= MAX_WIDTH and found[2][1].get("output_dim") == 1:
                return kind, width
    names = ", ".join(f"{name} ({settings.get('activation', '-')})" for name, settings in found) or "none"
    raise ModelError(f"{path}: layers are {names}: neither the thesis's MLP nor its LSTM")


def _layers(path: Path, config: str) -> list[tuple[str, dict[str, Any]]]:
    try:
        return [(str(layer["class_name"]), dict(layer["config"])) for layer in json.loads(config).get("config", [])]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise ModelError(f"{path}: its `model_config` is not that of a Keras 1 model") from None


def _is_as(found: tuple[str, dict[str, Any]], expected: tuple[str, dict[str, Any]]) -> bool:
    return found[0] == expected[0] and all(found[1].get(key) == value for key, value in expected[1].items())


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _shapes(kind: Kind, width: int) -> dict[str, tuple[int, ...]]:
    """Return the expected shape of each array by its name in the file."""
    if kind == "mlp":
        return {"dense_1_W": (4, width), "dense_1_b": (width,), "dense_2_W": (width, 1), "dense_2_b": (1,)}
    parts = {"W": (1, width), "U": (width, width), "b": (width,)}
    cells = {f"lstm_1_{part}_{gate}": shape for gate in GATES for part, shape in parts.items()}
    return {**cells, "dense_1_W": (width, 1), "dense_1_b": (1,)}


def _array(path: Path, file: h5py.File, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return one array of weights; external and virtual data sets are rejected."""
    place = f"model_weights/{name[: name.index('_', name.index('_') + 1)]}/{name}"
    item = file.get(place)
    if not isinstance(item, h5py.Dataset) or item.file != file or item.external is not None or item.is_virtual:
        raise ModelError(f"{path}: contains no array {place}: not one of the thesis's networks")
    if item.shape != shape or item.dtype.kind != "f":
        raise ModelError(f"{path}: {place} is {item.dtype} of shape {item.shape}, expected float32 of shape {shape}")
    value = np.asarray(item[()], dtype=np.float64)
    if not np.isfinite(value).all():
        raise ModelError(f"{path}: {place} contains a weight that is not finite; download the file again")
    return value
