"""Layers of networks, compiled: many pings at once, in single precision and always in the same order.

Values are (width, `BLOCK`): a block of pings side by side, so that the compiler uses vector instructions. A block that
is not full is computed all the same, so a ping has the same result, to the bit, whatever stands beside it; a library's
matrix product does not promise that. The inputs of a layer are filled up with zero weights to a multiple of `GROUP`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from acquisition.arrays import Floats, Ints, Singles
from noise.learned.tensors import Layers

BLOCK = 32  # pings
GROUP = 4  # inputs of a layer that are added at a time
_CLIP = np.float32(7.9)  # beyond it tanh is 1 in single precision
_F = np.float32
# products may be fused with sums; infinities and the order of sums are kept
fused = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})


def packed(layers: Layers) -> tuple[Singles, Ints]:
    """Return the weights and biases of dense layers in one array, and the widths of all layers, the input first.

    The widths of inputs and hidden layers are multiples of `GROUP`.
    """
    first, last = layers[0][0].shape[1], len(layers) - 1
    wide = [(_filled(w, k < last), _filled(b, k < last)) for k, (w, b) in enumerate(layers)]
    wide = [(np.pad(w, ((0, 0), (0, -w.shape[1] % GROUP))), b) for w, b in wide]
    sizes = [first + -first % GROUP, *(len(bias) for _, bias in wide)]
    return np.concatenate([part.ravel() for layer in wide for part in layer]).astype(np.float32), np.array(sizes)


def _filled(values: Floats, hidden: bool) -> Floats:
    """Return the weights or biases of a layer, with zeros up to a multiple of `GROUP` outputs if it is hidden."""
    return np.pad(values, [(0, -len(values) % GROUP if hidden else 0), *[(0, 0)] * (values.ndim - 1)])


@fused
def dense(weights: Singles, at: int, n_in: int, n_out: int, x: Singles, y: Singles) -> int:
    """Write the outputs of a layer whose weights begin at a place, and return the place after its biases.

    The number of inputs is a multiple of `GROUP`.
    """
    end = at + n_in * n_out
    for o in range(n_out):
        row, base, bias = y[o], at + o * n_in, weights[end + o]
        for r in range(BLOCK):
            row[r] = bias
        for k in range(0, n_in, GROUP):
            w0, w1, w2, w3 = weights[base + k], weights[base + k + 1], weights[base + k + 2], weights[base + k + 3]
            x0, x1, x2, x3 = x[k], x[k + 1], x[k + 2], x[k + 3]
            for r in range(BLOCK):
                row[r] += w0 * x0[r] + w1 * x1[r] + w2 * x2[r] + w3 * x3[r]
    return end + n_out


@fused
def tanh(y: Singles, first: int, last: int) -> None:
    """Replace rows `first` to `last` by their hyperbolic tangents, exact to 3e-7 (rational approximation of Eigen)."""
    for o in range(first, last):
        row = y[o]
        for r in range(BLOCK):
            v = min(max(row[r], -_CLIP), _CLIP)
            s = v * v
            p = _F(-2.76076847742355e-16) * s + _F(2.00018790482477e-13)
            p = p * s + _F(-8.60467152213735e-11)
            p = p * s + _F(5.12229709037114e-08)
            p = p * s + _F(1.48572235717979e-05)
            p = p * s + _F(6.37261928875436e-04)
            p = p * s + _F(4.89352455891786e-03)
            q = _F(1.19825839466702e-06) * s + _F(1.18534705686654e-04)
            q = q * s + _F(2.26843463243900e-03)
            q = q * s + _F(4.89352518554385e-03)
            row[r] = v * p / q


@fused
def network(weights: Singles, sizes: Ints, x: Singles, y: Singles) -> Singles:
    """Return the outputs of dense layers with tanh between them, in `x` or `y`, which are overwritten.

    Args:
        weights: weights and biases of all layers.
        sizes: widths of all layers, the input first.
        x: inputs in its first rows; (width, BLOCK), with room for the widest layer.
        y: like `x`.
    """
    at, last = 0, sizes.shape[0] - 2
    for layer in range(last + 1):
        at = dense(weights, at, sizes[layer], sizes[layer + 1], x, y)
        if layer < last:
            tanh(y, 0, sizes[layer + 1])
        x, y = y, x
    return x


@fused
def logistic(x: float) -> float:
    """Return 1 / (1 + exp(-x))."""
    return 1.0 / (1.0 + math.exp(-x)) if x > -700.0 else 0.0
