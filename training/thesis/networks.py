"""The MLP and the LSTM of Esmi (2016), each a function of one flat vector of parameters.

MLP: four inputs, one hidden layer of sigmoids, dropout, a sigmoid output. LSTM: the four inputs as a sequence of single
numbers, 25 cells with hard-sigmoid gates and sigmoid activations, dropout, a linear output. Layers and initial weights
are those of the published Keras 1 files (`dense_1`, `lstm_1`): uniform as in He et al. (2015) for the weights of the
inputs, orthogonal for the recurrent weights, Glorot for the output; biases are 0, those of the forget gates 1.
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
Shapes = dict[str, tuple[int, ...]]
Initialiser = Callable[[tuple[int, ...], np.random.Generator], NDArray[np.float64]]
N_GATES = 4  # of an LSTM cell, in this order: input, forget, output, candidate


@dataclass(frozen=True)
class FlatNetwork:
    """Architecture of a network, and the layout of its flat parameter vector.

    Attributes:
        kind: "mlp" or "lstm".
        hidden: number of hidden neurons or LSTM cells.
    """

    kind: Kind
    hidden: int

    @cached_property
    def shapes(self) -> Shapes:
        """Shape of each array of parameters, in the order of the vector."""
        return SHAPES[self.kind](self.hidden)

    @cached_property
    def size(self) -> int:
        """Number of weights and biases.

        >>> FlatNetwork("mlp", 30).size  # Listing A.1 of the thesis
        181
        """
        return sum(math.prod(shape) for shape in self.shapes.values())

    @cached_property
    def penalised(self) -> NDArray[np.bool_]:
        """Mask of the parameters to which l1 and l2 apply: all but biases (thesis, section 3.3), (size,)."""
        lengths = {name: math.prod(shape) for name, shape in self.shapes.items()}
        return np.concatenate([np.full(length, not name.endswith("bias")) for name, length in lengths.items()])

    def arrays(self, theta: Tensor) -> list[Tensor]:
        """Return the arrays of a flat vector (size,) as views."""
        lengths = [math.prod(shape) for shape in self.shapes.values()]
        parts = torch.split(theta, lengths)
        return [part.view(shape) for part, shape in zip(parts, self.shapes.values(), strict=True)]

    def initial(self, rng: np.random.Generator) -> Singles:
        """Draw initial parameters, (size,)."""
        arrays = {name: INITIAL[name](shape, rng) for name, shape in self.shapes.items()}
        return np.concatenate([array.ravel() for array in arrays.values()]).astype(np.float32)

    def output(self, theta: Tensor, feature: Tensor, dropout_mask: Tensor | None = None) -> Tensor:
        """Return the rescaled distances of pings, (n,).

        Args:
            theta: parameters, (size,).
            feature: inputs, (n, 4).
            dropout_mask: factor of each hidden unit, 0 for dropped units, (n, hidden); None for no dropout.
        """
        return FORWARD[self.kind](self.arrays(theta), feature, dropout_mask)

    def predict(self, theta: Singles, feature: Singles) -> Singles:
        """Return the rescaled distances of pings with inputs (n, 4), without dropout, (n,)."""
        parameters, parts = torch.from_numpy(theta), torch.from_numpy(feature).split(8192)
        with torch.no_grad():
            return np.concatenate([self.output(parameters, part).numpy() for part in parts])


def _mlp_shapes(hidden: int) -> Shapes:
    return {"input": (len(FEATURES), hidden), "bias": (hidden,), "output": (hidden,), "output_bias": (1,)}


def _lstm_shapes(hidden: int) -> Shapes:
    gates = {"step": (N_GATES, hidden), "recurrent": (hidden, N_GATES, hidden), "gate_bias": (N_GATES, hidden)}
    return {**gates, "output": (hidden,), "output_bias": (1,)}


SHAPES: dict[Kind, Callable[[int], Shapes]] = {"mlp": _mlp_shapes, "lstm": _lstm_shapes}


def _zeros(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float64]:
    return np.zeros(shape)


def _he(fan_in: int) -> Initialiser:
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


def _gate_bias(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float64]:
    return np.repeat([[0.0], [1.0], [0.0], [0.0]], shape[1], axis=1)


# initial values of each array; an LSTM cell has one input per step, so its fan-in is 1
INITIAL: dict[str, Initialiser] = {
    "input": _he(len(FEATURES)),
    "bias": _zeros,
    "step": _he(1),
    "recurrent": _orthogonal,
    "gate_bias": _gate_bias,
    "output": _glorot,
    "output_bias": _zeros,
}


def _mlp(arrays: list[Tensor], feature: Tensor, dropout_mask: Tensor | None) -> Tensor:
    weight, bias, out, out_bias = arrays
    hidden = torch.sigmoid(torch.addmm(bias, feature, weight))
    return torch.sigmoid((hidden if dropout_mask is None else hidden * dropout_mask) @ out + out_bias)


def _lstm(arrays: list[Tensor], feature: Tensor, dropout_mask: Tensor | None) -> Tensor:
    step, recurrent, gate_bias, out, out_bias = arrays
    hidden = cell = feature.new_zeros(len(feature), step.shape[1])
    for value in feature.T:
        z = value[:, None, None] * step + torch.einsum("nh,hgk->ngk", hidden, recurrent) + gate_bias
        gates = torch.clamp(0.2 * z[:, :3] + 0.5, 0.0, 1.0)  # Keras 1's hard sigmoid
        cell = gates[:, 1] * cell + gates[:, 0] * torch.sigmoid(z[:, 3])
        hidden = gates[:, 2] * torch.sigmoid(cell)
    return (hidden if dropout_mask is None else hidden * dropout_mask) @ out + out_bias


FORWARD: dict[Kind, Callable[[list[Tensor], Tensor, Tensor | None], Tensor]] = {"mlp": _mlp, "lstm": _lstm}
