"""Compiled online training: one optimiser step after every ping, as in the thesis.

With a network of 181 parameters, the calls of torch themselves take most of the time. An epoch of 123,100 pings is one
compiled call, about a hundred times faster. The update rules are those of `training.thesis.fit.OPTIMISERS`, the
networks those of `training.thesis.networks`; tests compare both with torch step by step.

`learn` combines two kinds of function on flat vectors, each compiled once for one signature: a *gradient* function
writes the gradient of one ping's squared error and returns that error; a *rule* updates the parameters by a gradient.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from training.thesis.data import Floats, OptimiserName, Singles
from training.thesis.networks import Kind

Compiled = Callable[..., Any]
Single = Any  # float32 in compiled code

_vector, _matrix, _table = types.float32[::1], types.float32[:, ::1], types.float64[::1]
GRADIENT = types.float64(_vector, _vector, types.float32, _vector, _vector)
RULE = types.void(_vector, _vector, _matrix, _table, _table)
HALF, FIFTH, ONE, TWO = np.float32(0.5), np.float32(0.2), np.float32(1.0), np.float32(2.0)


@njit(cache=True, fastmath=True, inline="always")
def _sigmoid(x: Single) -> Single:
    return ONE / (ONE + math.exp(-x))


@njit(cache=True)
def _mlp_arrays(theta: Singles, inputs: int, hidden: int) -> tuple[Singles, Singles, Singles, Singles]:
    """Return weights and biases of the hidden layer, then of the output, as views."""
    bias, out = inputs * hidden, (inputs + 1) * hidden
    return theta[:bias].reshape(inputs, hidden), theta[bias:out], theta[out : out + hidden], theta[out + hidden :]


@njit(cache=True)
def _lstm_arrays(theta: Singles, hidden: int) -> tuple[Singles, Singles, Singles, Singles, Singles]:
    """Return input weights, recurrent weights and gate biases, then weights and bias of the output, as views."""
    wide = 4 * hidden
    bias, out = (hidden + 1) * wide, (hidden + 2) * wide
    recurrent = theta[wide:bias].reshape(hidden, wide)
    return theta[:wide], recurrent, theta[bias:out], theta[out : out + hidden], theta[out + hidden :]


@njit(GRADIENT, cache=True, fastmath=True, nogil=True)
def mlp_gradient(theta: Singles, x: Singles, label: Single, dropout_mask: Singles, gradient: Singles) -> float:
    """Write the gradient of (output - label)^2 of one ping into `gradient`; return the squared error."""
    hidden, inputs = len(dropout_mask), len(x)
    first, bias, out, last = _mlp_arrays(theta, inputs, hidden)
    d_first, d_bias, d_out, d_last = _mlp_arrays(gradient, inputs, hidden)
    unit, total = np.empty(hidden, np.float32), last[0]
    for j in range(hidden):
        z = bias[j]
        for i in range(inputs):
            z += x[i] * first[i, j]
        unit[j] = _sigmoid(z)
        total += unit[j] * dropout_mask[j] * out[j]
    output = _sigmoid(total)
    error = output - label
    d_last[0] = TWO * error * output * (ONE - output)
    for j in range(hidden):
        d_out[j] = d_last[0] * unit[j] * dropout_mask[j]
        d_bias[j] = d_last[0] * out[j] * dropout_mask[j] * unit[j] * (ONE - unit[j])
        for i in range(inputs):
            d_first[i, j] = d_bias[j] * x[i]
    return error * error


@njit(cache=True, fastmath=True)
def _lstm_forward(theta: Singles, x: Singles, gate: Singles, cell: Singles, squashed: Singles, state: Singles) -> None:
    """Run the sequence, one input per step.

    Args:
        theta: parameters, (size,).
        x: inputs, (steps,).
        gate: output; gates and candidate of each step, (steps, 4 * hidden).
        cell: output; cell values, the first row 0, (steps + 1, hidden).
        squashed: output; sigmoids of the cell values, (steps, hidden).
        state: output; hidden states, the first row 0, (steps + 1, hidden).
    """
    steps, hidden = squashed.shape
    first, recurrent, bias, _, _ = _lstm_arrays(theta, hidden)
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
            squashed[t, h] = _sigmoid(cell[t + 1, h])
            state[t + 1, h] = z[2 * hidden + h] * squashed[t, h]


@njit(cache=True, fastmath=True)
def _hard_derivative(value: Single) -> Single:
    """Return the derivative of the hard sigmoid from its value: 0 where it is saturated."""
    return FIFTH if 0.0 < value < 1.0 else np.float32(0.0)


@njit(cache=True, fastmath=True)
def _gate_gradients(
    z: Singles, before: Singles, squashed: Singles, d_state: Singles, d_cell: Singles, d: Singles
) -> None:
    """Write the gradient with respect to one step's gate inputs into `d`; propagate `d_cell` one step back."""
    hidden = len(squashed)
    for h in range(hidden):
        gate_in, forget, out, candidate = z[h], z[hidden + h], z[2 * hidden + h], z[3 * hidden + h]
        d_cell[h] += d_state[h] * out * squashed[h] * (ONE - squashed[h])
        d[h] = d_cell[h] * candidate * _hard_derivative(gate_in)
        d[hidden + h] = d_cell[h] * before[h] * _hard_derivative(forget)
        d[2 * hidden + h] = d_state[h] * squashed[h] * _hard_derivative(out)
        d[3 * hidden + h] = d_cell[h] * gate_in * candidate * (ONE - candidate)
        d_cell[h] *= forget


@njit(cache=True, fastmath=True)
def _weight_gradients(
    theta: Singles, value: Single, state: Singles, d: Singles, gradient: Singles, d_state: Singles
) -> None:
    """Add one step's contribution to the gradient; write that of the previous hidden state into `d_state`."""
    recurrent = _lstm_arrays(theta, len(state))[1]
    d_first, d_recurrent, d_bias, _, _ = _lstm_arrays(gradient, len(state))
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
def lstm_gradient(theta: Singles, x: Singles, label: Single, dropout_mask: Singles, gradient: Singles) -> float:
    """Write the gradient of (output - label)^2 of one ping into `gradient`, through all steps; return the error."""
    steps, hidden = len(x), len(dropout_mask)
    gate, squashed = np.empty((steps, 4 * hidden), np.float32), np.empty((steps, hidden), np.float32)
    cell, state = np.zeros((steps + 1, hidden), np.float32), np.zeros((steps + 1, hidden), np.float32)
    _lstm_forward(theta, x, gate, cell, squashed, state)
    out, last = _lstm_arrays(theta, hidden)[3:]
    error = last[0] - label
    for h in range(hidden):
        error += state[steps, h] * dropout_mask[h] * out[h]
    gradient[:] = 0.0
    d_out, d_last = _lstm_arrays(gradient, hidden)[3:]
    d_last[0] = TWO * error
    d_state, d_cell = np.empty(hidden, np.float32), np.zeros(hidden, np.float32)
    d = np.empty(4 * hidden, np.float32)
    for h in range(hidden):
        d_out[h] = d_last[0] * state[steps, h] * dropout_mask[h]
        d_state[h] = d_last[0] * dropout_mask[h] * out[h]
    for t in range(steps - 1, -1, -1):
        _gate_gradients(gate[t], cell[t], squashed[t], d_state, d_cell, d)
        _weight_gradients(theta, x[t], state[t], d, gradient, d_state)
    return error * error


# Arguments of a rule: parameters, their gradient, two accumulators per parameter (initially 0), counters (number of
# steps and, for Nadam, product of all momenta so far), and settings in the order of `training.thesis.fit.OPTIMISERS`.


@njit(RULE, cache=True, fastmath=True, nogil=True)
def sgd(theta: Singles, gradient: Singles, accumulators: Singles, counters: Floats, settings: Floats) -> None:
    """Step against the gradient."""
    rate = np.float32(settings[0])
    for k in range(len(theta)):
        theta[k] -= rate * gradient[k]


@njit(RULE, cache=True, fastmath=True, nogil=True)
def adagrad(theta: Singles, gradient: Singles, accumulators: Singles, counters: Floats, settings: Floats) -> None:
    """Divide by the root of the sum of squared gradients (thesis, eq. 2.11)."""
    rate, eps, square = np.float32(settings[0]), np.float32(settings[1]), accumulators[0]
    for k in range(len(theta)):
        square[k] += gradient[k] * gradient[k]
        theta[k] -= rate * gradient[k] / (math.sqrt(square[k]) + eps)


@njit(RULE, cache=True, fastmath=True, nogil=True)
def adadelta(theta: Singles, gradient: Singles, accumulators: Singles, counters: Floats, settings: Floats) -> None:
    """Divide by the root mean square of gradients, multiply by that of previous steps (thesis, eq. 2.12)."""
    rate, rho, eps = np.float32(settings[0]), np.float32(settings[1]), np.float32(settings[2])
    square, moved = accumulators[0], accumulators[1]
    for k in range(len(theta)):
        square[k] = rho * square[k] + (ONE - rho) * gradient[k] * gradient[k]
        step = gradient[k] * math.sqrt(moved[k] + eps) / math.sqrt(square[k] + eps)
        moved[k] = rho * moved[k] + (ONE - rho) * step * step
        theta[k] -= rate * step


@njit(RULE, cache=True, fastmath=True, nogil=True)
def rmsprop(theta: Singles, gradient: Singles, accumulators: Singles, counters: Floats, settings: Floats) -> None:
    """Divide by the root of a decaying mean of squared gradients (thesis, eqs. 2.13, 2.14)."""
    rate, rho, eps = np.float32(settings[0]), np.float32(settings[1]), np.float32(settings[2])
    square = accumulators[0]
    for k in range(len(theta)):
        square[k] = rho * square[k] + (ONE - rho) * gradient[k] * gradient[k]
        theta[k] -= rate * gradient[k] / (math.sqrt(square[k]) + eps)


@njit(cache=True, fastmath=True)
def _moments(gradient: Singles, accumulators: Singles, b1: Single, b2: Single) -> None:
    """Update the decaying means of gradients and of their squares (thesis, eqs. 2.15, 2.16)."""
    mean, square = accumulators[0], accumulators[1]
    for k in range(len(gradient)):
        mean[k] = b1 * mean[k] + (ONE - b1) * gradient[k]
        square[k] = b2 * square[k] + (ONE - b2) * gradient[k] * gradient[k]


@njit(RULE, cache=True, fastmath=True, nogil=True)
def adam(theta: Singles, gradient: Singles, accumulators: Singles, counters: Floats, settings: Floats) -> None:
    """Divide the mean gradient by the root of the mean square, both bias-corrected (thesis, eqs. 2.15 to 2.19)."""
    rate, b1, b2, eps = settings
    _moments(gradient, accumulators, np.float32(b1), np.float32(b2))
    mean_rate = np.float32(rate / (1.0 - b1 ** counters[0]))
    correction, floor = np.float32(1.0 / math.sqrt(1.0 - b2 ** counters[0])), np.float32(eps)
    mean, square = accumulators[0], accumulators[1]
    for k in range(len(theta)):
        theta[k] -= mean_rate * mean[k] / (math.sqrt(square[k]) * correction + floor)


@njit(RULE, cache=True, fastmath=True, nogil=True)
def nadam(theta: Singles, gradient: Singles, accumulators: Singles, counters: Floats, settings: Floats) -> None:
    """Adam with the momentum of the next step (Dozat 2016; thesis, eqs. 2.20 to 2.27)."""
    rate, b1, b2, eps, decay = settings
    _moments(gradient, accumulators, np.float32(b1), np.float32(b2))
    momentum = b1 * (1.0 - 0.5 * 0.96 ** (counters[0] * decay))
    next_momentum = b1 * (1.0 - 0.5 * 0.96 ** ((counters[0] + 1.0) * decay))
    counters[1] *= momentum
    gradient_rate = np.float32(rate * (1.0 - momentum) / (1.0 - counters[1]))
    mean_rate = np.float32(rate * next_momentum / (1.0 - counters[1] * next_momentum))
    correction, floor = np.float32(1.0 / math.sqrt(1.0 - b2 ** counters[0])), np.float32(eps)
    mean, square = accumulators[0], accumulators[1]
    for k in range(len(theta)):
        theta[k] -= (gradient_rate * gradient[k] + mean_rate * mean[k]) / (math.sqrt(square[k]) * correction + floor)


GRADIENTS: dict[Kind, Compiled] = {"mlp": mlp_gradient, "lstm": lstm_gradient}
RULES: dict[OptimiserName, Compiled] = {
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
def learn(
    gradient_of: Compiled,
    rule: Compiled,
    theta: Singles,
    accumulators: Singles,
    counters: Floats,
    settings: Floats,
    feature: Singles,
    label: Singles,
    order: NDArray[np.int64],
    dropout_mask: Singles,
    penalty: Singles,
) -> float:
    """Make one step after each ping; return the mean squared error before each step.

    Args:
        gradient_of: one of `GRADIENTS`.
        rule: one of `RULES`.
        theta: parameters, changed in place, (size,).
        accumulators: of the rule, changed in place, (2, size).
        counters: number of steps and product of momenta, changed in place; initially 0 and 1.
        settings: of the rule.
        feature: inputs, (n, 4).
        label: rescaled distances, (n,).
        order: rows of the pings in the order of training.
        dropout_mask: factor of each hidden unit at each step, (len(order), hidden).
        penalty: coefficients of |w| and of w^2 in the objective for each parameter, (2, size).
    """
    gradient = np.zeros(len(theta), np.float32)
    lasso, decay = penalty
    penalised = bool(np.any(penalty > 0.0))
    total = 0.0
    for step in range(len(order)):
        row = order[step]
        total += gradient_of(theta, feature[row], label[row], dropout_mask[step], gradient)
        if penalised:
            for k in range(len(theta)):
                gradient[k] += lasso[k] * np.sign(theta[k]) + TWO * decay[k] * theta[k]
        counters[0] += 1.0
        rule(theta, gradient, accumulators, counters, settings)
    return total / len(order)
