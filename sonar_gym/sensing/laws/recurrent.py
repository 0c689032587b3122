"""`noise.learned.recurrent.LstmModel`, compiled, with its memory in whole numbers of 16 bits.

A state has two bytes per number: hidden values lie within -1..1, those of the cell within -`CELL_LIMIT`..`CELL_LIMIT`.
The features of earlier pings are those of `noise.learned.recurrent_state.PingHistory`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import Bytes, Floats, Ints, Singles
from noise.learned.mixture import UNIT_M
from noise.learned.networks import MlpModel
from noise.learned.recurrent import LstmModel
from sonar_gym.compiled import compiled
from sonar_gym.sensing.laws import mixture
from sonar_gym.sensing.laws.dense import BLOCK, dense, fused, network, packed, tanh
from sonar_gym.sensing.laws.drawn import PathDraws, PathLaw, PathPings, PathSource
from sonar_gym.sensing.laws.mixture import ECHO, MAX_COMPONENTS, Shape
from sonar_gym.sensing.laws.perceptron import Features, write_features

N_HISTORY = 12  # features of earlier pings
HIDDEN_UNIT, CELL_LIMIT = 1.0 / 32767.0, 32.0
CELL_UNIT = CELL_LIMIT / 32767.0
DISTANCE, ANGLE, INCIDENCE, REFLECTANCE, TIME, RANGE, ERROR = range(7)  # columns of `Memory.last`
EMPTY = 255  # status of a place without an earlier ping
_F = np.float32


class Memory(NamedTuple):
    """Memory at p places.

    Attributes:
        hidden, cell: state of the LSTM, in `HIDDEN_UNIT` and `CELL_UNIT`, (p, hidden).
        last: condition, time and reading of the last ping, and error of the last echo, (p, 7).
        status: status of the last ping, or `EMPTY`, (p,).
        has_echo: whether there was an earlier echo, (p,).
    """

    hidden: NDArray[np.int16]
    cell: NDArray[np.int16]
    last: Singles
    status: Bytes
    has_echo: Bytes

    @classmethod
    def of(cls, places: int, hidden: int) -> Memory:
        """Return an empty memory."""
        states = np.zeros((2, places, hidden), np.int16)
        flags = np.full(places, EMPTY, np.uint8), np.zeros(places, np.uint8)
        return cls(states[0], states[1], np.zeros((places, 7), np.float32), *flags)


class Weights(NamedTuple):
    """Weights of an LSTM and of the networks on top of it.

    Attributes:
        cell: weights on input and hidden state, and biases of the gates, as of one layer.
        head: weights of the perceptron.
        head_sizes: widths of its layers.
        base: weights of the network that is corrected; empty without one.
        base_sizes: widths of its layers.
        base_rows: outputs of the perceptron that it is added to.
    """

    cell: Singles
    head: Singles
    head_sizes: Ints
    base: Singles
    base_sizes: Ints
    base_rows: Ints

    @classmethod
    def of(cls, model: LstmModel) -> Weights:
        """Return the weights of a model."""
        gates = np.concatenate([model.cell.on_input, model.cell.on_hidden], axis=1)
        base: tuple[Any, ...] = (np.zeros(0, np.float32), np.zeros(0, np.int64), np.zeros(0, np.int64))
        if isinstance(model.base, MlpModel):
            base = *packed(model.base.layers), model.head.indices_of(model.base.head)
        return cls(packed([(gates, model.cell.bias)])[0], *packed(model.layers), *base)


@compiled
def write_history(m: Memory, place: int, pings: Floats, time: float, i: int, x: Singles, at: int, r: int) -> None:
    """Write the features of earlier pings into column r of a block, from row `at` on; zero before the first ping."""
    for k in range(N_HISTORY):
        x[at + k, r] = 0.0
    if m.status[place] == EMPTY:
        return
    last, error = m.last[place], m.last[place, ERROR]
    x[at, r] = 1.0
    x[at + 1, r] = math.log1p(min(max(time - last[TIME], 0.0), 100.0)) / 4.0
    x[at + 2, r] = math.asinh((pings[DISTANCE, i] - last[DISTANCE]) / UNIT_M) / 7.0
    for k in range(ANGLE, TIME):
        x[at + 2 + k, r] = math.tanh(20.0 * (pings[k, i] - last[k]))
    x[at + 6 + m.status[place], r] = 1.0
    x[at + 9, r] = math.asinh(error / UNIT_M) / 7.0
    x[at + 10, r] = min(max(error / 0.05, -1.0), 1.0)
    x[at + 11, r] = m.has_echo[place]


@fused
def load_state(m: Memory, place: int, x: Singles, at: int, cell: Singles, r: int) -> None:
    """Write the state at a place into column r of blocks."""
    for k in range(m.hidden.shape[1]):
        x[at + k, r] = m.hidden[place, k] * _F(HIDDEN_UNIT)
        cell[k, r] = m.cell[place, k] * _F(CELL_UNIT)


@fused
def update_state(gates: Singles, cell: Singles, x: Singles, at: int, width: int) -> None:
    """Replace the cell and the hidden state of a block, given the gates: input, forget, cell, output."""
    half = _F(0.5)
    for k in range(3 * width, 4 * width):
        for r in range(BLOCK):
            gates[k, r] *= half
    for k in range(2 * width):
        for r in range(BLOCK):
            gates[k, r] *= half
    tanh(gates, 0, 4 * width)
    for k in range(width):
        for r in range(BLOCK):
            take, keep = half + half * gates[k, r], half + half * gates[width + k, r]
            cell[k, r] = keep * cell[k, r] + take * gates[2 * width + k, r]
            gates[k, r] = cell[k, r]
    tanh(gates, 0, width)
    for k in range(width):
        for r in range(BLOCK):
            x[at + k, r] = (half + half * gates[3 * width + k, r]) * gates[k, r]


@fused
def store_state(m: Memory, place: int, x: Singles, at: int, cell: Singles, r: int) -> None:
    """Write column r of blocks to a place, rounded."""
    limit, half, per_hidden, per_cell = _F(CELL_LIMIT), _F(0.5), _F(1.0 / HIDDEN_UNIT), _F(1.0 / CELL_UNIT)
    for k in range(m.hidden.shape[1]):
        m.hidden[place, k] = math.floor(x[at + k, r] * per_hidden + half)
        m.cell[place, k] = math.floor(min(max(cell[k, r], -limit), limit) * per_cell + half)


@compiled
def remember(m: Memory, place: int, pings: Floats, time: float, i: int, reading: float, status: int) -> None:
    """Write a ping and its reading to a place."""
    last = m.last[place]
    for k in range(TIME):
        last[k] = pings[k, i]
    last[TIME], last[RANGE], m.status[place] = time, reading, status
    if status == ECHO:
        last[ERROR], m.has_echo[place] = reading - pings[DISTANCE, i], 1


@compiled
def anchors(m: Memory, place: int, distance: float) -> tuple[float, float]:
    """Return the ranges about which components lie: the last echo moved with the reflector, and the last reading, m."""
    if m.status[place] == EMPTY:
        return distance, distance
    moved = distance + (m.last[place, ERROR] if m.has_echo[place] else 0.0)
    return moved, (float(m.last[place, RANGE]) if m.status[place] == ECHO else distance)


class Blocks(NamedTuple):
    """Scratch of a block of pings, (rows, BLOCK) each.

    Attributes:
        inputs: features of the conditions, of earlier pings, and the hidden state.
        cell: cell of the LSTM.
        x, y: layers of the perceptron, and the gates.
        base_x, base_y: layers of the network that is corrected.
    """

    inputs: Singles
    cell: Singles
    x: Singles
    y: Singles
    base_x: Singles
    base_y: Singles


@compiled
def outputs(w: Weights, b: Blocks, own: int, at: int, width: int) -> Singles:
    """Advance the state of a block, and return the outputs of the network.

    Args:
        w: weights.
        b: the block; its inputs and cell are given.
        own: number of features of the conditions.
        at: row of the hidden state in the inputs.
        width: of the hidden state.
    """
    filled = w.head_sizes[0]  # `at + width` and rows of zeros
    dense(w.cell, 0, filled, 4 * width, b.inputs, b.x)
    update_state(b.x, b.cell, b.inputs, at, width)
    b.x[:filled] = b.inputs[:filled]
    out = network(w.head, w.head_sizes, b.x, b.y)
    if w.base_sizes.shape[0] > 0:
        b.base_x[:own] = b.inputs[:own]
        base = network(w.base, w.base_sizes, b.base_x, b.base_y)
        for k in range(w.base_rows.shape[0]):
            out[w.base_rows[k]] += base[k]
    return out


@compiled
def draw_recurrent(
    f: Features, w: Weights, shape: Shape, m: Memory, rows: int, max_range: float, time: Floats, places: Ints,
    pings: Floats, uniform: Floats,
) -> tuple[Floats, Bytes, Floats]:  # fmt: skip
    """Return ranges, m, statuses and credences given the condition of m pings, and update the memory.

    Args:
        f: features.
        w: weights.
        shape: meaning of the outputs.
        m: memory.
        rows: width of the widest layer.
        max_range: range beyond which an echo is none, m.
        time: of the pings, s, (m,).
        places: their places in the memory, all different, (m,).
        pings: conditions, (4, m).
        uniform: random numbers, (2, m).
    """
    n, width, own = pings.shape[1], m.hidden.shape[1], f.columns.shape[0] + 1 + f.covariates
    at, scratch = own + N_HISTORY, np.zeros((6, rows, BLOCK), np.float32)
    b = Blocks(scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5])
    reading, status, credence = np.empty(n), np.empty(n, np.uint8), np.empty(n)
    excess, share = np.empty(BLOCK), np.empty(MAX_COMPONENTS + 2)
    for start in range(0, n, BLOCK):
        size = min(BLOCK, n - start)
        for r in range(size):
            i = start + r
            excess[r] = write_features(f, pings, i, b.inputs, r)
            write_history(m, places[i], pings, time[i], i, b.inputs, own, r)
            load_state(m, places[i], b.inputs, at, b.cell, r)
        out = outputs(w, b, own, at, width)
        for r in range(size):
            i = start + r
            value, kind, credence[i] = mixture.draw(
                out, r, shape, pings[0, i], excess[r], anchors(m, places[i], pings[0, i]),
                (uniform[0, i], uniform[1, i]), share,
            )  # fmt: skip
            if value > max_range:
                value, kind = 0.0, mixture.NO_ECHO
            reading[i], status[i] = value, kind
            store_state(m, places[i], b.inputs, at, b.cell, r)
            remember(m, places[i], pings, time[i], i, value, kind)
    return reading, status, credence


class Recurrent(PathLaw):
    """The law of an `LstmModel`, with a memory of its own.

    Args:
        model: the model; covariates that the pings lack are missing.
        places: number of places in the memory.
        max_range: range beyond which an echo is none, m.
    """

    def __init__(self, model: LstmModel, places: int, max_range: float) -> None:
        self._features, self._shape, self._weights = Features.of(model.inputs), Shape.of(model.head), Weights.of(model)
        self._memory, self._max_range = Memory.of(places, model.cell.hidden), max_range
        width, w = model.cell.hidden, self._weights
        self._rows = max(4 * width, w.head_sizes.max(), w.base_sizes.max(initial=0))

    def draw(self, pings: PathPings, source: PathSource) -> PathDraws:
        """Draw the readings of m pings, and remember them."""
        uniform = source.random((2, pings.conditions.shape[1]))
        law = self._features, self._weights, self._shape, self._memory, int(self._rows), self._max_range
        return PathDraws(*draw_recurrent(*law, pings.time, pings.places, pings.conditions, uniform), None)

    def clear(self, places: Ints) -> None:
        """Clear the memory at some places."""
        for part in (self._memory.hidden, self._memory.cell, self._memory.last, self._memory.has_echo):
            part[places] = 0
        self._memory.status[places] = EMPTY
