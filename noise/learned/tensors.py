"""Weights on disk: safetensors beside a description, and nothing but the tensors that it calls for."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from acquisition import ModelError

WEIGHTS_FILE, CARD_FILE = "weights.safetensors", "README.md"
Layers = Sequence[tuple[np.ndarray, np.ndarray]]
HEADER_BYTES = 65_536  # more than a safetensors header of ours takes


def write_tensors(folder: Path, tensors: Mapping[str, np.ndarray], card: str) -> None:
    """Write weights in single precision, and the card where there is one, into a folder."""
    save_file({name: np.ascontiguousarray(value, dtype=np.float32) for name, value in tensors.items()}, _file(folder))
    _file(folder).chmod(0o644)
    if card:
        (folder / CARD_FILE).write_text(card, encoding="utf-8")


def read_tensors(folder: Path, shapes: Mapping[str, tuple[int, ...]]) -> tuple[dict[str, np.ndarray], str]:
    """Read tensors of the given shapes, and nothing else; returns them and the card's text.

    Raises:
        ModelError: the file is missing, truncated, of another size than the shapes call for, or holds other things.
    """
    path, needed = _file(folder), 4 * sum(math.prod(shape) for shape in shapes.values())
    try:
        size = os.path.getsize(path)
        if not needed <= size <= needed + HEADER_BYTES:
            raise ModelError(f"{path}: has {size} bytes, expected {needed} and a header; it is damaged or foreign")
        tensors = load_file(path)
    except FileNotFoundError:
        raise ModelError(f"{path}: is missing; a network's folder holds its weights beside its description") from None
    except (SafetensorError, OSError) as error:
        raise ModelError(f"{path}: cannot be read as safetensors ({error}); it is damaged or foreign") from None
    if {name: value.shape for name, value in tensors.items()} != shapes:
        raise ModelError(f"{path}: holds other tensors than its description calls for ({', '.join(shapes)})")
    if not all(value.dtype == np.float32 and np.all(np.isfinite(value)) for value in tensors.values()):
        raise ModelError(f"{path}: holds numbers that are not finite float32; it is damaged")
    card = folder / CARD_FILE
    return tensors, card.read_text(encoding="utf-8") if card.is_file() else ""


def tensors_of(layers: Layers, prefix: str = "") -> dict[str, np.ndarray]:
    """Return layers under the names that they are kept by."""
    named = {f"{prefix}{i}.weight": weight for i, (weight, _) in enumerate(layers)}
    return named | {f"{prefix}{i}.bias": bias for i, (_, bias) in enumerate(layers)}


def shapes_of(sizes: Sequence[int], prefix: str = "") -> dict[str, tuple[int, ...]]:
    """Return the shapes of the tensors of layers of given widths, the input first."""
    named: dict[str, tuple[int, ...]] = {f"{prefix}{i}.weight": (b, a) for i, (a, b) in enumerate(pairwise(sizes))}
    return named | {f"{prefix}{i}.bias": (size,) for i, size in enumerate(sizes[1:])}


def layers_of(tensors: Mapping[str, np.ndarray], count: int, prefix: str = "") -> Layers:
    """Return layers from the tensors that keep them."""
    return [(tensors[f"{prefix}{i}.weight"], tensors[f"{prefix}{i}.bias"]) for i in range(count)]


def _file(folder: Path) -> Path:
    return folder / WEIGHTS_FILE
