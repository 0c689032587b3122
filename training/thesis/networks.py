"""The thesis's two networks on one flat vector of weights, so that every optimiser and engine steps the same numbers.

MLP: four inputs, one hidden layer of sigmoids, dropout, a sigmoid. LSTM: the four inputs one after the other as a
sequence of single numbers, 25 cells with hard-sigmoid gates and sigmoid activations, dropout, a linear output. Both as
the published Keras 1 files have them (`dense_1`, `lstm_1`), their first weights included: uniform as in He et al.
(2015) for what the inputs meet, orthogonal between the cells, Glorot for the output, biases zero but one for the
forget gates.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.stats import ortho_group
from torch import Tensor

from training.thesis.data import FEATURES, Singles

Kind = Literal["mlp", "lstm"]
GATES = 4  # of a cell, in this order: input, forget, output, candidate


@dataclass(frozen=True)
class Network:
    """The shape of a network: what its flat vector of weights means.

    Attributes:
        kind: mlp or lstm.
        hidden: neurons or cells.
    """

    kind: Kind
    hidden: int

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each array of weights, in the order of the vector."""
        return SHAPES[self.kind](self.hidden)

    @cached_property
    def size(self) -> int:
        """Number of weights and biases.

        >>> Network("mlp", 30).size  # Listing A.1 of the thesis
        181
        """
        return sum(math.prod(shape) for shape in self.shapes.values())

    @cached_property
    def penalised(self) -> NDArray[np.bool_]:
        """Which numbers are weights; biases are not decayed (thesis, section 3.3), (size,)."""
        return np.concatenate([np.full(math.prod(s), not k.endswith("bias")) for k, s in self.shapes.items()])

    def arrays(self, theta: Tensor) -> list[Tensor]:
        """Return the arrays of a flat vector (size,), as views."""
        lengths = [math.prod(shape) for shape in self.shapes.values()]
        parts = torch.split(theta, lengths)
        return [part.view(shape) for part, shape in zip(parts, self.shapes.values(), strict=True)]

    def first(self, rng: np.random.Generator) -> Singles:
        """Draw the weights to begin with, (size,)."""
        arrays = {name: FIRST[name](shape, rng) for name, shape in self.shapes.items()}
        return np.concatenate([array.ravel() for array in arrays.values()]).astype(np.float32)

    def output(self, theta: Tensor, feature: Tensor, keep: Tensor | None = None) -> Tensor:
        """Return the network's rescaled distances.

        Args:
            theta: weights, (size,).
            feature: inputs, (n, 4).
            keep: what each hidden unit is multiplied by, (n, hidden): 0 for dropped ones; None drops none.
        """
        return OUTPUT[self.kind](self.arrays(theta), feature, keep)

    def predict(self, theta: Singles, feature: Singles) -> Singles:
        """Return the rescaled distances of any number of pings, (n,)."""
        weights = torch.from_numpy(theta)
        with torch.no_grad():
            return np.concatenate([self.output(weights, part).numpy() for part in _parts(feature)])


def _parts(feature: Singles, size: int = 8192) -> tuple[Tensor, ...]:
    return torch.split(torch.from_numpy(feature), size)


def _mlp_shapes(hidden: int) -> dict[str, tuple[int, ...]]:
    return {"input": (len(FEATURES), hidden), "bias": (hidden,), "output": (hidden,), "output_bias": (1,)}


def _lstm_shapes(hidden: int) -> dict[str, tuple[int, ...]]:
    gates = {"step": (GATES, hidden), "recurrent": (hidden, GATES, hidden), "gate_bias": (GATES, hidden)}
    return {**gates, "output": (hidden,), "output_bias": (1,)}


SHAPES: dict[str, Callable[[int], dict[str, tuple[int, ...]]]] = {"mlp": _mlp_shapes, "lstm": _lstm_shapes}


def _zeros(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float64]:
    return np.zeros(shape)


def _he(fan_in: int) -> Callable[[tuple[int, ...], np.random.Generator], NDArray[np.float64]]:
    limit = math.sqrt(6.0 / fan_in)
    return lambda shape, rng: rng.uniform(-limit, limit, shape)


def _glorot(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float64]:
    limit = math.sqrt(6.0 / (shape[0] + 1))
    return rng.uniform(-limit, limit, shape)


def _orthogonal(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float64]:
    hidden, gates, _ = shape
    if hidden == 1:
        return rng.choice([-1.0, 1.0], shape)
    return np.stack([ortho_group.rvs(hidden, random_state=rng) for _ in range(gates)], axis=1)


def _forget_one(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float64]:
    return np.repeat([[0.0], [1.0], [0.0], [0.0]], shape[1], axis=1)


# how each array begins; an LSTM's cell meets one number a step, so its fan-in is 1
FIRST: dict[str, Callable[[tuple[int, ...], np.random.Generator], NDArray[np.float64]]] = {
    "input": _he(len(FEATURES)),
    "bias": _zeros,
    "step": _he(1),
    "recurrent": _orthogonal,
    "gate_bias": _forget_one,
    "output": _glorot,
    "output_bias": _zeros,
}


def _mlp(arrays: list[Tensor], feature: Tensor, keep: Tensor | None) -> Tensor:
    weight, bias, out, out_bias = arrays
    hidden = torch.sigmoid(torch.addmm(bias, feature, weight))
    return torch.sigmoid((hidden if keep is None else hidden * keep) @ out + out_bias)


def _lstm(arrays: list[Tensor], feature: Tensor, keep: Tensor | None) -> Tensor:
    step, recurrent, gate_bias, out, out_bias = arrays
    hidden = cell = feature.new_zeros(len(feature), step.shape[1])
    for value in feature.T:
        z = value[:, None, None] * step + torch.einsum("nh,hgk->ngk", hidden, recurrent) + gate_bias
        opened = torch.clamp(0.2 * z[:, :3] + 0.5, 0.0, 1.0)  # Keras 1's hard sigmoid
        cell = opened[:, 1] * cell + opened[:, 0] * torch.sigmoid(z[:, 3])
        hidden = opened[:, 2] * torch.sigmoid(cell)
    return (hidden if keep is None else hidden * keep) @ out + out_bias


OUTPUT: dict[str, Callable[[list[Tensor], Tensor, Tensor | None], Tensor]] = {"mlp": _mlp, "lstm": _lstm}
