"""The two networks of the thesis, with all weights in one flat vector, so that all optimisers update the same numbers.

MLP: four inputs, one hidden layer of sigmoids, dropout, a sigmoid output. LSTM: the four inputs as a sequence of single
numbers, 25 cells with hard-sigmoid gates and sigmoid activations, dropout, a linear output. Both follow the published
Keras 1 files (`dense_1`, `lstm_1`), including the initial weights: He et al. (2015) uniform for the inputs, orthogonal
for the recurrent weights, Glorot uniform for the output, biases 0 except 1 for the forget gates.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from scipy.stats import ortho_group
from torch import Tensor

from training.thesis.data import FEATURES, Bits, Floats, Singles

Kind = Literal["mlp", "lstm"]
Shape = tuple[int, ...]
GATES = 4  # of a cell, in this order: input, forget, output, candidate
ROWS_AT_ONCE = 8192


@dataclass(frozen=True)
class FlatNetwork:
    """Architecture of a network, which defines the layout of its flat weight vector.

    Attributes:
        kind: mlp or lstm.
        hidden: number of hidden neurons or LSTM cells.
    """

    kind: Kind
    hidden: int

    @cached_property
    def shapes(self) -> dict[str, Shape]:
        """Shape of each weight array, in the order of the vector."""
        return SHAPES[self.kind](self.hidden)

    @cached_property
    def size(self) -> int:
        """Number of weights and biases.

        >>> FlatNetwork("mlp", 30).size  # Listing A.1 of the thesis
        181
        """
        return sum(math.prod(shape) for shape in self.shapes.values())

    @cached_property
    def penalised(self) -> Bits:
        """Which parameters are weights; biases are not penalised (thesis, section 3.3), (size,)."""
        return np.concatenate([np.full(math.prod(s), not k.endswith("bias")) for k, s in self.shapes.items()])

    def arrays(self, theta: Tensor) -> list[Tensor]:
        """Return views of the weight arrays in a flat vector (size,)."""
        parts = torch.split(theta, [math.prod(shape) for shape in self.shapes.values()])
        return [part.view(shape) for part, shape in zip(parts, self.shapes.values(), strict=True)]

    def initial(self, rng: np.random.Generator) -> Singles:
        """Draw initial weights, (size,)."""
        arrays = {name: INITIAL[name](shape, rng) for name, shape in self.shapes.items()}
        return np.concatenate([array.ravel() for array in arrays.values()]).astype(np.float32)

    def output(self, theta: Tensor, feature: Tensor, mask: Tensor | None = None) -> Tensor:
        """Return the rescaled distances, (n,).

        Args:
            theta: weights, (size,).
            feature: inputs, (n, 4).
            mask: dropout factor of each hidden unit, (n, hidden); None for no dropout.
        """
        return OUTPUT[self.kind](self.arrays(theta), feature, mask)

    def predict(self, theta: Singles, feature: Singles) -> Singles:
        """Return the rescaled distances of any number of pings without dropout, (n,)."""
        weights, parts = torch.from_numpy(theta), torch.split(torch.from_numpy(feature), ROWS_AT_ONCE)
        with torch.no_grad():
            return np.concatenate([self.output(weights, part).numpy() for part in parts])


def _mlp_shapes(hidden: int) -> dict[str, Shape]:
    return {"input": (len(FEATURES), hidden), "bias": (hidden,), "output": (hidden,), "output_bias": (1,)}


def _lstm_shapes(hidden: int) -> dict[str, Shape]:
    gates = {"step": (GATES, hidden), "recurrent": (hidden, GATES, hidden), "gate_bias": (GATES, hidden)}
    return {**gates, "output": (hidden,), "output_bias": (1,)}


SHAPES: dict[str, Callable[[int], dict[str, Shape]]] = {"mlp": _mlp_shapes, "lstm": _lstm_shapes}


def _zeros(shape: Shape, rng: np.random.Generator) -> Floats:
    return np.zeros(shape)


def _he(fan_in: int) -> Callable[[Shape, np.random.Generator], Floats]:
    limit = math.sqrt(6.0 / fan_in)
    return lambda shape, rng: rng.uniform(-limit, limit, shape)


def _glorot(shape: Shape, rng: np.random.Generator) -> Floats:
    limit = math.sqrt(6.0 / (shape[0] + 1))
    return rng.uniform(-limit, limit, shape)


def _orthogonal(shape: Shape, rng: np.random.Generator) -> Floats:
    hidden, gates, _ = shape
    if hidden == 1:
        return rng.choice([-1.0, 1.0], shape)
    return np.stack([ortho_group.rvs(hidden, random_state=rng) for _ in range(gates)], axis=1)


def _forget_bias(shape: Shape, rng: np.random.Generator) -> Floats:
    return np.repeat([[0.0], [1.0], [0.0], [0.0]], shape[1], axis=1)


# initial law of each array; an LSTM cell receives one number per step, so its fan-in is 1
INITIAL: dict[str, Callable[[Shape, np.random.Generator], Floats]] = {
    "input": _he(len(FEATURES)),
    "bias": _zeros,
    "step": _he(1),
    "recurrent": _orthogonal,
    "gate_bias": _forget_bias,
    "output": _glorot,
    "output_bias": _zeros,
}


def _mlp(arrays: list[Tensor], feature: Tensor, mask: Tensor | None) -> Tensor:
    weight, bias, out, out_bias = arrays
    hidden = torch.sigmoid(torch.addmm(bias, feature, weight))
    return torch.sigmoid((hidden if mask is None else hidden * mask) @ out + out_bias)


def _lstm(arrays: list[Tensor], feature: Tensor, mask: Tensor | None) -> Tensor:
    step, recurrent, gate_bias, out, out_bias = arrays
    hidden = cell = feature.new_zeros(len(feature), step.shape[1])
    for value in feature.T:
        z = value[:, None, None] * step + torch.einsum("nh,hgk->ngk", hidden, recurrent) + gate_bias
        gate = torch.clamp(0.2 * z[:, :3] + 0.5, 0.0, 1.0)  # Keras 1's hard sigmoid
        cell = gate[:, 1] * cell + gate[:, 0] * torch.sigmoid(z[:, 3])
        hidden = gate[:, 2] * torch.sigmoid(cell)
    return (hidden if mask is None else hidden * mask) @ out + out_bias


OUTPUT: dict[str, Callable[[list[Tensor], Tensor, Tensor | None], Tensor]] = {"mlp": _mlp, "lstm": _lstm}
