"""Learning online, a step after every single ping, compiled: the thesis's way, a hundred times faster than by torch.

A network of 181 weights is too small for a library that is called a hundred times a step. Here a pass over 123,100
pings is one call. The rules are those of `training.thesis.optimisers` and the networks those of `training.thesis.networks`;
the tests hold both to torch's own numbers, step by step.

Three kinds of function meet in `learn`, each compiled once for one signature:
a *slope* adds up the gradient of one ping's squared error and returns that error; a *rule* moves the weights by a
gradient; both work on flat vectors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Floats = NDArray[np.float64]
Compiled = Callable[..., Any]
Single = Any  # a float32 in compiled code

_vector, _matrix, _table = types.float32[::1], types.float32[:, ::1], types.float64[::1]
SLOPE = types.float64(_vector, _vector, types.float32, _vector, _vector)
RULE = types.void(_vector, _vector, _matrix, _table, _table)
HALF, FIFTH, ONE, TWO = np.float32(0.5), np.float32(0.2), np.float32(1.0), np.float32(2.0)


@njit(cache=True, fastmath=True, inline="always")
def _sigmoid(x: Single) -> Single:
    return ONE / (ONE + math.exp(-x))


@njit(cache=True)
def _mlp_parts(theta: Singles, inputs: int, hidden: int) -> tuple[Singles, Singles, Singles, Singles]:
    """Return weights and biases of the hidden layer and of the output, as views."""
    bias, out = inputs * hidden, (inputs + 1) * hidden
    return theta[:bias].reshape(inputs, hidden), theta[bias:out], theta[out : out + hidden], theta[out + hidden :]


@njit(cache=True)
def _lstm_parts(theta: Singles, hidden: int) -> tuple[Singles, Singles, Singles, Singles, Singles]:
    """Return weights of the input, between the cells, biases of the gates; weights and bias of the output; views."""
    wide = 4 * hidden
    bias, out = (hidden + 1) * wide, (hidden + 2) * wide
    between = theta[wide:bias].reshape(hidden, wide)
    return theta[:wide], between, theta[bias:out], theta[out : out + hidden], theta[out + hidden :]


@njit(SLOPE, cache=True, fastmath=True, nogil=True)
def mlp_slope(theta: Singles, x: Singles, label: Single, keep: Singles, slope: Singles) -> float:
    """Write the gradient of (output - label)^2 of one ping into `slope`; return the squared error."""
    hidden, inputs = len(keep), len(x)
    first, bias, out, last = _mlp_parts(theta, inputs, hidden)
    d_first, d_bias, d_out, d_last = _mlp_parts(slope, inputs, hidden)
    unit, total = np.empty(hidden, np.float32), last[0]
    for j in range(hidden):
        z = bias[j]
        for i in range(inputs):
            z += x[i] * first[i, j]
        unit[j] = _sigmoid(z)
        total += unit[j] * keep[j] * out[j]
    answer = _sigmoid(total)
    error = answer - label
    d_last[0] = TWO * error * answer * (ONE - answer)
    for j in range(hidden):
        d_out[j] = d_last[0] * unit[j] * keep[j]
        d_bias[j] = d_last[0] * out[j] * keep[j] * unit[j] * (ONE - unit[j])
        for i in range(inputs):
            d_first[i, j] = d_bias[j] * x[i]
    return error * error


@njit(cache=True, fastmath=True)
def _lstm_forward(theta: Singles, x: Singles, gate: Singles, cell: Singles, squashed: Singles, state: Singles) -> None:
    """Run the sequence, one input a step.

    Args:
        theta: weights.
        x: inputs, (steps,).
        gate: is given the opened gates and the candidate of each step, (steps, 4 * hidden).
        cell: is given the cells, zeros first, (steps + 1, hidden).
        squashed: is given the sigmoids of the cells, (steps, hidden).
        state: is given the states, zeros first, (steps + 1, hidden).
    """
    steps, hidden = squashed.shape
    first, between, bias, _, _ = _lstm_parts(theta, hidden)
    for t in range(steps):
        z = gate[t]
        for k in range(4 * hidden):
            z[k] = bias[k] + x[t] * first[k]
        if t > 0:
            for h in range(hidden):
                s, row = state[t, h], between[h]
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
def _hard(value: Single) -> Single:
    """Return the slope of the hard sigmoid by its value: none where it is shut or wide open."""
    return FIFTH if 0.0 < value < 1.0 else np.float32(0.0)


@njit(cache=True, fastmath=True)
def _gate_slopes(z: Singles, before: Singles, squashed: Singles, d_state: Singles, d_cell: Singles, d: Singles) -> None:
    """Write the slopes at one step's gates, before they are squashed, into `d`; carry `d_cell` one step back."""
    hidden = len(squashed)
    for h in range(hidden):
        opened, forget, out, candidate = z[h], z[hidden + h], z[2 * hidden + h], z[3 * hidden + h]
        d_cell[h] += d_state[h] * out * squashed[h] * (ONE - squashed[h])
        d[h] = d_cell[h] * candidate * _hard(opened)
        d[hidden + h] = d_cell[h] * before[h] * _hard(forget)
        d[2 * hidden + h] = d_state[h] * squashed[h] * _hard(out)
        d[3 * hidden + h] = d_cell[h] * opened * candidate * (ONE - candidate)
        d_cell[h] *= forget


@njit(cache=True, fastmath=True)
def _weight_slopes(theta: Singles, value: Single, state: Singles, d: Singles, slope: Singles, d_state: Singles) -> None:
    """Add one step's share to the slopes of the weights, and write that at the state before it into `d_state`."""
    between = _lstm_parts(theta, len(state))[1]
    d_first, d_between, d_bias, _, _ = _lstm_parts(slope, len(state))
    for k in range(len(d)):
        d_first[k] += value * d[k]
        d_bias[k] += d[k]
    for h in range(len(state)):
        s, row, d_row, total = state[h], between[h], d_between[h], np.float32(0.0)
        for k in range(len(d)):
            d_row[k] += s * d[k]
            total += row[k] * d[k]
        d_state[h] = total


@njit(SLOPE, cache=True, fastmath=True, nogil=True)
def lstm_slope(theta: Singles, x: Singles, label: Single, keep: Singles, slope: Singles) -> float:
    """Write the gradient of (output - label)^2 of one ping into `slope`, back through all steps; return the error."""
    steps, hidden = len(x), len(keep)
    gate, squashed = np.empty((steps, 4 * hidden), np.float32), np.empty((steps, hidden), np.float32)
    cell, state = np.zeros((steps + 1, hidden), np.float32), np.zeros((steps + 1, hidden), np.float32)
    _lstm_forward(theta, x, gate, cell, squashed, state)
    out, last = _lstm_parts(theta, hidden)[3:]
    error = last[0] - label
    for h in range(hidden):
        error += state[steps, h] * keep[h] * out[h]
    slope[:] = 0.0
    d_out, d_last = _lstm_parts(slope, hidden)[3:]
    d_last[0] = TWO * error
    d_state, d_cell = np.empty(hidden, np.float32), np.zeros(hidden, np.float32)
    d = np.empty(4 * hidden, np.float32)
    for h in range(hidden):
        d_out[h] = d_last[0] * state[steps, h] * keep[h]
        d_state[h] = d_last[0] * keep[h] * out[h]
    for t in range(steps - 1, -1, -1):
        _gate_slopes(gate[t], cell[t], squashed[t], d_state, d_cell, d)
        _weight_slopes(theta, x[t], state[t], d, slope, d_state)
    return error * error


# A rule is given the weights, their slope, two numbers of memory a weight (zero at first), a clock (steps done, and
# for Nadam the product of all momenta so far) and its settings in the order of `training.thesis.optimisers.OPTIMISERS`.


@njit(RULE, cache=True, fastmath=True, nogil=True)
def sgd(theta: Singles, slope: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Step against the gradient."""
    rate = np.float32(settings[0])
    for k in range(len(theta)):
        theta[k] -= rate * slope[k]


@njit(RULE, cache=True, fastmath=True, nogil=True)
def adagrad(theta: Singles, slope: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Divide by the root of the sum of all squared gradients (thesis, eq. 2.11)."""
    rate, eps, square = np.float32(settings[0]), np.float32(settings[1]), memory[0]
    for k in range(len(theta)):
        square[k] += slope[k] * slope[k]
        theta[k] -= rate * slope[k] / (math.sqrt(square[k]) + eps)


@njit(RULE, cache=True, fastmath=True, nogil=True)
def adadelta(theta: Singles, slope: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Divide by the root mean square of gradients, multiply by that of earlier steps (thesis, eq. 2.12)."""
    rate, rho, eps = np.float32(settings[0]), np.float32(settings[1]), np.float32(settings[2])
    square, moved = memory[0], memory[1]
    for k in range(len(theta)):
        square[k] = rho * square[k] + (ONE - rho) * slope[k] * slope[k]
        step = slope[k] * math.sqrt(moved[k] + eps) / math.sqrt(square[k] + eps)
        moved[k] = rho * moved[k] + (ONE - rho) * step * step
        theta[k] -= rate * step


@njit(RULE, cache=True, fastmath=True, nogil=True)
def rmsprop(theta: Singles, slope: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Divide by the root of a decaying mean of squared gradients (thesis, eqs. 2.13, 2.14)."""
    rate, rho, eps = np.float32(settings[0]), np.float32(settings[1]), np.float32(settings[2])
    square = memory[0]
    for k in range(len(theta)):
        square[k] = rho * square[k] + (ONE - rho) * slope[k] * slope[k]
        theta[k] -= rate * slope[k] / (math.sqrt(square[k]) + eps)


@njit(cache=True, fastmath=True)
def _moments(slope: Singles, memory: Singles, b1: Single, b2: Single) -> None:
    """Update the decaying means of gradients and of their squares (thesis, eqs. 2.15, 2.16)."""
    mean, square = memory[0], memory[1]
    for k in range(len(slope)):
        mean[k] = b1 * mean[k] + (ONE - b1) * slope[k]
        square[k] = b2 * square[k] + (ONE - b2) * slope[k] * slope[k]


@njit(RULE, cache=True, fastmath=True, nogil=True)
def adam(theta: Singles, slope: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Step along the mean gradient over the root of the mean square, both without their bias (eqs. 2.15 to 2.19)."""
    rate, b1, b2, eps = settings
    _moments(slope, memory, np.float32(b1), np.float32(b2))
    ahead = np.float32(rate / (1.0 - b1 ** clock[0]))
    fair, floor = np.float32(1.0 / math.sqrt(1.0 - b2 ** clock[0])), np.float32(eps)
    mean, square = memory[0], memory[1]
    for k in range(len(theta)):
        theta[k] -= ahead * mean[k] / (math.sqrt(square[k]) * fair + floor)


@njit(RULE, cache=True, fastmath=True, nogil=True)
def nadam(theta: Singles, slope: Singles, memory: Singles, clock: Floats, settings: Floats) -> None:
    """Step as Adam does, with the momentum of the step to come (Dozat 2016; thesis, eqs. 2.20 to 2.27)."""
    rate, b1, b2, eps, decay = settings
    _moments(slope, memory, np.float32(b1), np.float32(b2))
    now = b1 * (1.0 - 0.5 * 0.96 ** (clock[0] * decay))
    soon = b1 * (1.0 - 0.5 * 0.96 ** ((clock[0] + 1.0) * decay))
    clock[1] *= now
    here = np.float32(rate * (1.0 - now) / (1.0 - clock[1]))
    ahead = np.float32(rate * soon / (1.0 - clock[1] * soon))
    fair, floor = np.float32(1.0 / math.sqrt(1.0 - b2 ** clock[0])), np.float32(eps)
    mean, square = memory[0], memory[1]
    for k in range(len(theta)):
        theta[k] -= (here * slope[k] + ahead * mean[k]) / (math.sqrt(square[k]) * fair + floor)


SLOPES: dict[str, Compiled] = {"mlp": mlp_slope, "lstm": lstm_slope}
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
        types.FunctionType(SLOPE),
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
    slope_of: Compiled,
    rule: Compiled,
    theta: Singles,
    memory: Singles,
    clock: Floats,
    settings: Floats,
    feature: Singles,
    label: Singles,
    order: NDArray[np.int64],
    keep: Singles,
    penalty: Singles,
) -> float:
    """Take one step after each ping; return the mean squared error met on the way.

    Args:
        slope_of: of `SLOPES`.
        rule: of `RULES`.
        theta: weights, changed in place, (size,).
        memory: of the rule, changed in place, (2, size).
        clock: steps done and product of momenta, changed in place; 0 and 1 at first.
        settings: of the rule.
        feature: inputs, (n, 4).
        label: rescaled distances, (n,).
        order: in which pings are met.
        keep: what each hidden unit is multiplied by at each step, (len(order), hidden).
        penalty: weight of |w| and of w^2 in what is made small, for each weight, (2, size).
    """
    slope = np.zeros(len(theta), np.float32)
    lasso, decay = penalty
    penalised = bool(np.any(penalty > 0.0))
    total = 0.0
    for step in range(len(order)):
        row = order[step]
        total += slope_of(theta, feature[row], label[row], keep[step], slope)
        if penalised:
            for k in range(len(theta)):
                slope[k] += lasso[k] * np.sign(theta[k]) + TWO * decay[k] * theta[k]
        clock[0] += 1.0
        rule(theta, slope, memory, clock, settings)
    return total / len(order)
