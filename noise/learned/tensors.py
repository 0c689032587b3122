"""Weights on disk as safetensors, checked against the expected names and shapes."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from acquisition import ModelError, SettingError
from acquisition.arrays import Floats
from acquisition.io.files import is_folder, read_limited
from acquisition.limits import as_numbers, shown

WEIGHTS_FILE, CARD_FILE = "weights.safetensors", "README.md"
Layers = Sequence[tuple[np.ndarray, np.ndarray]]
HEADER_BYTES = 65_536  # upper limit of a safetensors header


def write_tensors(folder: Path, tensors: Mapping[str, np.ndarray], card: str) -> None:
    """Write weights in single precision, and the card if there is one, into a folder."""
    if not is_folder(folder):
        raise ModelError(f"{folder}: is not a folder; make it before weights are written into it")
    data = save({name: np.ascontiguousarray(value, dtype=np.float32) for name, value in tensors.items()})
    _file(folder).write_bytes(data)
    _file(folder).chmod(0o644)
    if card:
        (folder / CARD_FILE).write_text(card, encoding="utf-8")


def read_tensors(folder: Path, shapes: Mapping[str, tuple[int, ...]]) -> tuple[dict[str, np.ndarray], str]:
    """Return the tensors of the given names and shapes, and the text of the card.

    Raises:
        ModelError: the file is missing or damaged, or its tensors or size differ from the expected ones.
    """
    path, needed = _file(folder), 4 * sum(math.prod(shape) for shape in shapes.values())
    try:
        size = os.path.getsize(path) if path.is_file() or not path.exists() else 0  # a pipe has no end
        if not needed <= size <= needed + HEADER_BYTES:
            raise ModelError(
                f"{path}: has {size} bytes, expected {needed} and a header; it is damaged or of another model"
            )
        tensors = load_file(path)
    except FileNotFoundError:
        raise ModelError(
            f"{path}: is missing; the folder of a network needs its weights beside the description"
        ) from None
    except (SafetensorError, OSError) as error:
        raise ModelError(
            f"{path}: cannot be read as safetensors ({error}); it is damaged or of another model"
        ) from None
    if {name: value.shape for name, value in tensors.items()} != shapes:
        raise ModelError(f"{path}: the tensors differ from those of the description ({', '.join(shapes)})")
    if not all(value.dtype == np.float32 and np.all(np.isfinite(value)) for value in tensors.values()):
        raise ModelError(f"{path}: contains values that are not finite float32; it is damaged")
    card = folder / CARD_FILE
    return tensors, read_limited(card, ModelError, "a model card").decode("utf-8", "replace") if card.is_file() else ""


def tensors_of(layers: Layers, prefix: str = "") -> dict[str, np.ndarray]:
    """Return the weights of layers by their names in the file."""
    named = {f"{prefix}{i}.weight": weight for i, (weight, _) in enumerate(layers)}
    return named | {f"{prefix}{i}.bias": bias for i, (_, bias) in enumerate(layers)}


def shapes_of(sizes: Sequence[int], prefix: str = "") -> dict[str, tuple[int, ...]]:
    """Return the shapes of the weights of layers, given their widths, the input first."""
    named: dict[str, tuple[int, ...]] = {f"{prefix}{i}.weight": (b, a) for i, (a, b) in enumerate(pairwise(sizes))}
    return named | {f"{prefix}{i}.bias": (size,) for i, size in enumerate(sizes[1:])}


def as_layers(name: str, layers: Layers) -> list[tuple[Floats, Floats]]:
    """Return layers in double precision.

    Raises:
        SettingError: they are no pairs of a matrix (out, in) and a bias (out,).
    """
    try:
        pairs = [(as_numbers(name, weight), as_numbers(name, bias)) for weight, bias in layers]
    except (TypeError, ValueError):
        pairs = []
    if not pairs or any(weight.ndim != 2 or bias.shape != weight.shape[:1] for weight, bias in pairs):
        raise SettingError(f"{name}: expected pairs of weights (out, in) and biases (out,), got {shown(layers)}")
    return pairs


def layers_of(tensors: Mapping[str, np.ndarray], count: int, prefix: str = "") -> Layers:
    """Return layers from the tensors of a file."""
    return [(tensors[f"{prefix}{i}.weight"], tensors[f"{prefix}{i}.bias"]) for i in range(count)]


def _file(folder: Path) -> Path:
    return folder / WEIGHTS_FILE
