"""Online training, one step per ping, compiled: about a hundred times faster than torch for networks of this size.

One pass over 123,100 pings is one compiled call. The update rules equal those of `training.thesis.fit.OPTIMISERS` and
the networks equal `training.thesis.networks`; the tests compare both with torch step by step.

`online_pass` takes two kinds of compiled functions, each with one signature, both on flat vectors: a *gradient* writes
the gradient of the squared error of one ping and returns this error; a *rule* updates the weights by a gradient.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from acquisition.arrays import Floats, Singles

Compiled = Callable[..., Any]
Single = Any  # a float32 in compiled code

_vector, _matrix, _table = types.float32[::1], types.float32[:, ::1], types.float64[::1]
GRADIENT = types.float64(_vector, _vector, types.float32, _vector, _vector)
RULE = types.void(_vector, _vector, _matrix, _table, _table)
HALF, FIFTH, ONE, TWO = np.float32(0.5), np.float32(0.2), np.float32(1.0), np.float32(2.0)


@njit(cache=True, fastmath=True, inline="always")
def _sigmoid(x: Single) -> Single:
    return ONE / (ONE + math.exp(-x))


@njit(cache=True)
def _mlp_parts(theta: Singles, inputs: int, hidden: int) -> tuple[Singles, Singles, Singles, Singles]:
    """Return views: weights and biases of the hidden layer, weights and bias of the output."""
    bias, out = inputs * hidden, (inputs + 1) * hidden
    return theta[:bias].reshape(inputs, hidden), theta[bias:out], theta[out : out + hidden], theta[out + hidden :]


@njit(cache=True)
def _lstm_parts(theta: Singles, hidden: int) -> tuple[Singles, Singles, Singles, Singles, Singles]:
    """Return views: input weights, recurrent weights and biases of the gates, weights and bias of the output."""
    width = 4 * hidden
    bias, out = (hidden + 1) * width, (hidden + 2) * width
    recurrent = theta[width:bias].reshape(hidden, width)
    return theta[:width], recurrent, theta[bias:out], theta[out : out + hidden], theta[out + hidden :]


@njit(GRADIENT, cache=True, fastmath=True, nogil=True)
def mlp_gradient(theta: Singles, x: Singles, label: Single, mask: Singles, gradient: Singles) -> float:
    """Write the gradient of (output - label)^2 for one ping into `gradient`; return the squared error."""
    hidden, inputs = len(mask), len(x)
    first, bias, out, last = _mlp_parts(theta, inputs, hidden)
    d_first, d_bias, d_out, d_last = _mlp_parts(gradient, inputs, hidden)
    unit, total = np.empty(hidden, np.float32), last[0]
    for j in range(hidden):
        z = bias[j]
        for i in range(inputs):
            z += x[i] * first[i, j]
        unit[j] = _sigmoid(z)
        total += unit[j] * mask[j] * out[j]
    output = _sigmoid(total)
    error = output - label
    d_last[0] = TWO * error * output * (ONE - output)
    for j in range(hidden):
        d_out[j] = d_last[0] * unit[j] * mask[j]
        d_bias[j] = d_last[0] * out[j] * mask[j] * unit[j] * (ONE - unit[j])
        for i in range(inputs):
            d_first[i, j] = d_bias[j] * x[i]
    return error * error


@njit(cache=True, fastmath=True)
def _lstm_forward(theta: Singles, x: Singles, gate: Singles, cell: Singles, activated: Singles, state: Singles) -> None:
    """Compute the forward pass, one input per step.

    Args:
        theta: weights.
        x: inputs, (steps,).
        gate: output: gates and candidate of each step, (steps, 4 * hidden).
        cell: output: cell states; row 0 is the initial zeros, (steps + 1, hidden).
        activated: output: sigmoids of the cell states, (steps, hidden).
        state: output: hidden states; row 0 is the initial zeros, (steps + 1, hidden).
    """
    steps, hidden = activated.shape
    first, recurrent, bias, _, _ = _lstm_parts(theta, hidden)
    for t in range(steps):
        z = gate[t]
        for k in range(4 * hidden):
            z[k] = bias[k] + x[t] * first[k]
        if t > 0:
            for h in range(hidden):
                s, row = state[t, h], recurrent[h]
                for k in range(4 * hidden):
                    z[k] += s * row[k]
        for k in range(3 * hidden):
            z[k] = min(max(FIFTH * z[k] + HALF, np.float32(0.0)), ONE)
        for h in range(hidden):
            z[3 * hidden + h] = _sigmoid(z[3 * hidden + h])
            cell[t + 1, h] = z[hidden + h] * cell[t, h] + z[h] * z[3 * hidden + h]
            activated[t, h] = _sigmoid(cell[t + 1, h])
            state[t + 1, h] = z[2 * hidden + h] * activated[t, h]


@njit(cache=True, fastmath=True)
def _hard(value: Single) -> Single:
    """Return the derivative of the hard sigmoid from its value: 0 where it is saturated."""
    return FIFTH if 0.0 < value < 1.0 else np.float32(0.0)


@njit(cache=True, fastmath=True)
def _gate_gradients(
    z: Singles, before: Singles, activated: Singles, d_state: Singles, d_cell: Singles, d: Singles
) -> None:
    """Write the gradient at the inputs of one step's gates into `d`; propagate `d_cell` one step back."""
    hidden = len(activated)
    for h in range(hidden):
        entry, forget, out, candidate = z[h], z[hidden + h], z[2 * hidden + h], z[3 * hidden + h]
        d_cell[h] += d_state[h] * out * activated[h] * (ONE - activated[h])
        d[h] = d_cell[h] * candidate * _hard(entry)
        d[hidden + h] = d_cell[h] * before[h] * _hard(forget)
        d[2 * hidden + h] = d_state[h] * activated[h] * _hard(out)
        d[3 * hidden + h] = d_cell[h] * entry * candidate * (ONE - candidate)
        d_cell[h] *= forget


@njit(cache=True, fastmath=True)
def _weight_gradients(
    theta: Singles, value: Single, state: Singles, d: Singles, gradient: Singles, d_state: Singles
) -> None:
    """Add one step's contribution to the weight gradient; write that of the previous state into `d_state`."""
    recurrent = _lstm_parts(theta, len(state))[1]
    d_first, d_recurrent, d_bias, _, _ = _lstm_parts(gradient, len(state))
    for k in range(len(d)):
        d_first[k] += value * d[k]
        d_bias[k] += d[k]
    for h in range(len(state)):
        s, row, d_row, total = state[h], recurrent[h], d_recurrent[h], np.float32(0.0)
        for k in range(len(d)):
            d_row[k] += s * d[k]
            total += row[k] * d[k]
        d_state[h] = total


@njit(GRADIENT, cache=True, fastmath=True, nogil=True)
def lstm_gradient(theta: Singles, x: Singles, label: Single, mask: Singles, gradient: Singles) -> float:
    """Write the gradient of (output - label)^2 for one ping into `gradient`; return the squared error."""
    steps, hidden = len(x), len(mask)
    gate, activated = np.empty((steps, 4 * hidden), np.float32), np.empty((steps, hidden), np.float32)
    cell, state = np.zeros((steps + 1, hidden), np.float32), np.zeros((steps + 1, hidden), np.float32)
    _lstm_forward(theta, x, gate, cell, activated, state)
    out, last = _lstm_parts(theta, hidden)[3:]
    error = last[0] - label
    for h in range(hidden):
        error += state[steps, h] * mask[h] * out[h]
    gradient[:] = 0.0
    d_out, d_last = _lstm_parts(gradient, hidden)[3:]
    d_last[0] = TWO * error
    d_state, d_cell = np.empty(hidden, np.float32), np.zeros(hidden, np.float32)
    d = np.empty(4 * hidden, np.float32)
    for h in range(hidden):
        d_out[h] = d_last[0] * state[steps, h] * mask[h]
        d_state[h] = d_last[0] * mask[h] * out[h]
    for t in range(steps - 1, -1, -1):
        _gate_gradients(gate[t], cell[t], activated[t], d_state, d_cell, d)
        _weight_gradients(theta, x[t], state[t], d, gradient, d_state)
    return error * error


# Arguments of a rule: the weights, their gradient, two state variables per weight (initially 0), a clock (number of
# steps, and for Nadam the product of all momenta so far), and its settings in the order of `fit.OPTIMISERS`.


@njit(RULE, cache=True, fastmath=True, nogil=True)
def sgd(theta: Singles, gradient: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Gradient descent."""
    rate = np.float32(settings[0])
    for k in range(len(theta)):
        theta[k] -= rate * gradient[k]


@njit(RULE, cache=True, fastmath=True, nogil=True)
def adagrad(theta: Singles, gradient: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Divide by the square root of the sum of all squared gradients (thesis, eq. 2.11)."""
    rate, eps, square = np.float32(settings[0]), np.float32(settings[1]), memory[0]
    for k in range(len(theta)):
        square[k] += gradient[k] * gradient[k]
        theta[k] -= rate * gradient[k] / (math.sqrt(square[k]) + eps)


@njit(RULE, cache=True, fastmath=True, nogil=True)
def adadelta(theta: Singles, gradient: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Multiply by the ratio of the RMS of previous steps to the RMS of gradients (thesis, eq. 2.12)."""
    rate, rho, eps = np.float32(settings[0]), np.float32(settings[1]), np.float32(settings[2])
    square, moved = memory[0], memory[1]
    for k in range(len(theta)):
        square[k] = rho * square[k] + (ONE - rho) * gradient[k] * gradient[k]
        step = gradient[k] * math.sqrt(moved[k] + eps) / math.sqrt(square[k] + eps)
        moved[k] = rho * moved[k] + (ONE - rho) * step * step
        theta[k] -= rate * step


@njit(RULE, cache=True, fastmath=True, nogil=True)
def rmsprop(theta: Singles, gradient: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Divide by the square root of a decaying mean of squared gradients (thesis, eqs. 2.13, 2.14)."""
    rate, rho, eps = np.float32(settings[0]), np.float32(settings[1]), np.float32(settings[2])
    square = memory[0]
    for k in range(len(theta)):
        square[k] = rho * square[k] + (ONE - rho) * gradient[k] * gradient[k]
        theta[k] -= rate * gradient[k] / (math.sqrt(square[k]) + eps)


@njit(cache=True, fastmath=True)
def _moments(gradient: Singles, memory: Singles, b1: Single, b2: Single) -> None:
    """Update the decaying means of gradients and of squared gradients (thesis, eqs. 2.15, 2.16)."""
    mean, square = memory[0], memory[1]
    for k in range(len(gradient)):
        mean[k] = b1 * mean[k] + (ONE - b1) * gradient[k]
        square[k] = b2 * square[k] + (ONE - b2) * gradient[k] * gradient[k]


@njit(RULE, cache=True, fastmath=True, nogil=True)
def adam(theta: Singles, gradient: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Divide the mean gradient by the RMS of gradients, both bias-corrected (thesis, eqs. 2.15 to 2.19)."""
    rate, b1, b2, eps = settings
    _moments(gradient, memory, np.float32(b1), np.float32(b2))
    mean_rate = np.float32(rate / (1.0 - b1 ** clock[0]))
    unbias, epsilon = np.float32(1.0 / math.sqrt(1.0 - b2 ** clock[0])), np.float32(eps)
    mean, square = memory[0], memory[1]
    for k in range(len(theta)):
        theta[k] -= mean_rate * mean[k] / (math.sqrt(square[k]) * unbias + epsilon)


@njit(RULE, cache=True, fastmath=True, nogil=True)
def nadam(theta: Singles, gradient: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Adam with the momentum of the next step (Dozat 2016; thesis, eqs. 2.20 to 2.27)."""
    rate, b1, b2, eps, decay = settings
    _moments(gradient, memory, np.float32(b1), np.float32(b2))
    momentum = b1 * (1.0 - 0.5 * 0.96 ** (clock[0] * decay))
    next_momentum = b1 * (1.0 - 0.5 * 0.96 ** ((clock[0] + 1.0) * decay))
    clock[1] *= momentum
    gradient_rate = np.float32(rate * (1.0 - momentum) / (1.0 - clock[1]))
    mean_rate = np.float32(rate * next_momentum / (1.0 - clock[1] * next_momentum))
    unbias, epsilon = np.float32(1.0 / math.sqrt(1.0 - b2 ** clock[0])), np.float32(eps)
    mean, square = memory[0], memory[1]
    for k in range(len(theta)):
        theta[k] -= (gradient_rate * gradient[k] + mean_rate * mean[k]) / (math.sqrt(square[k]) * unbias + epsilon)


GRADIENTS: dict[str, Compiled] = {"mlp": mlp_gradient, "lstm": lstm_gradient}
RULES: dict[str, Compiled] = {
    "sgd": sgd,
    "adagrad": adagrad,
    "adadelta": adadelta,
    "adam": adam,
    "rmsprop": rmsprop,
    "nadam": nadam,
}


@njit(
    types.float64(
        types.FunctionType(GRADIENT),
        types.FunctionType(RULE),
        _vector,
        _matrix,
        _table,
        _table,
        _matrix,
        _vector,
        types.int64[::1],
        _matrix,
        _matrix,
    ),
    cache=True,
    nogil=True,
)
def online_pass(
    gradient_of: Compiled,
    rule: Compiled,
    theta: Singles,
    memory: Singles,
    clock: Floats,
    settings: Floats,
    feature: Singles,
    label: Singles,
    order: NDArray[np.int64],
    mask: Singles,
    penalty: Singles,
) -> float:
    """Update the weights after each ping; return the mean squared error before the updates.

    Args:
        gradient_of: member of `GRADIENTS`.
        rule: member of `RULES`.
        theta: weights, changed in place, (size,).
        memory: state of the rule, changed in place, (2, size).
        clock: number of steps and product of momenta, changed in place; initially 0 and 1.
        settings: settings of the rule.
        feature: inputs, (n, 4).
        label: rescaled distances, (n,).
        order: order of the pings.
        mask: dropout factor of each hidden unit at each step, (len(order), hidden).
        penalty: weights of |w| and of w^2 in the objective, for each parameter, (2, size).
    """
    gradient = np.zeros(len(theta), np.float32)
    lasso, decay = penalty
    penalised = bool(np.any(penalty > 0.0))
    total = 0.0
    for step in range(len(order)):
        row = order[step]
        total += gradient_of(theta, feature[row], label[row], mask[step], gradient)
        if penalised:
            for k in range(len(theta)):
                gradient[k] += lasso[k] * np.sign(theta[k]) + TWO * decay[k] * theta[k]
        clock[0] += 1.0
        rule(theta, gradient, memory, clock, settings)
    return total / len(order)
