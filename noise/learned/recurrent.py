"""Learned laws with memory: an LSTM over the pings of one sensor, alone or on top of a perceptron.

Before each ping the network is told its condition, what the last ping faced and read, and how the two conditions
differ; its state keeps what all pings before have shown: how this sensor deviates, where this reflector really stands,
whether the wire is loose. Two components lie about what was heard last: the last echo moved along with the reflector,
for reflectors that stay where they are, and the last reading as it is, for registers that do.

`LstmModel.law` advances the state, so a model serves one set of sensors at a time; `fresh()` gives another listener
with the same weights. Whatever is asked without a past, or belongs to another run, begins with an empty memory.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from acquisition import EchoStatus, ModelError, Ping, Reading, SettingError
from noise.law import Floats
from noise.learned.inputs import Asked, Inputs
from noise.learned.mixture import UNIT_M, Head, MixtureLaw
from noise.learned.networks import MlpModel, dense, read_shape
from noise.learned.tensors import Layers, layers_of, read_tensors, shapes_of, tensors_of, write_tensors
from noise.model import steps

ANCHORS = 2  # the last echo moved along, the last reading
LINKS = 12  # numbers that tell what came before


@dataclass
class Before:
    """What is known of the pings before n pings.

    Attributes:
        known: whether there was any, (n,) bool.
        condition: distance, angle, incidence, reflectance, time of the last ping, (5, n).
        run: that it belonged to, (n,).
        range, status: that it read, (n,).
        off: by how much the last echo read too far, m, (n,); 0 before there was any.
        heard: whether there was an echo, (n,) bool.
    """

    known: NDArray[np.bool_]
    condition: Floats
    run: NDArray[np.int64]
    range: Floats
    status: NDArray[np.uint8]
    off: Floats
    heard: NDArray[np.bool_]

    @classmethod
    def nothing(cls, n: int) -> Before:
        """Return the memory of n sensors that have not pinged yet."""
        no = np.zeros(n, dtype=bool)
        return cls(no, np.zeros((5, n)), np.zeros(n, np.int64), np.zeros(n), np.zeros(n, np.uint8), np.zeros(n), no)

    @classmethod
    def each(cls, ping: Ping, reading: Reading) -> Before:
        """Return what is known before each ping of a recording, (n,), given the pings before it in its run."""
        order = np.argsort(ping.run, kind="stable")
        run, place = ping.run[order], np.arange(len(ping))
        first = np.r_[True, run[1:] != run[:-1]]
        start = np.maximum.accumulate(np.where(first, place, 0))
        last_echo = np.maximum.accumulate(np.where(reading.echo[order], place, -1))
        last_echo = np.r_[-1, last_echo[:-1]]
        known, heard = ~first, (last_echo >= start) & ~first
        one_before = order[np.maximum(place - 1, 0)]
        echoed = order[np.maximum(last_echo, 0)]
        off = np.where(heard, reading.range[echoed] - ping.distance[echoed], 0.0)
        in_order = cls(
            known, _condition(ping)[:, one_before], ping.run[one_before],
            np.where(known, reading.range[one_before], 0.0), reading.status[one_before], off, heard,
        )  # fmt: skip
        return in_order[np.argsort(order)]

    def __getitem__(self, rows: Any) -> Before:
        """Return the memory of some of the sensors."""
        return Before(*(getattr(self, f.name)[..., rows] for f in fields(self)))

    def then(self, condition: Floats, run: NDArray[np.int64], reading: Reading) -> Before:
        """Return what is known after one more ping of each sensor, in a condition, (5, n), and run."""
        echo = reading.echo
        off = np.where(echo, reading.range - condition[0], self.off)
        every = np.ones(len(run), dtype=bool)
        return Before(every, condition, run, reading.range, reading.status, off, self.heard | echo)

    def without(self, rows: NDArray[np.bool_]) -> Before:
        """Return the memory with some sensors' emptied."""
        keep = ~rows
        return Before(
            self.known & keep, self.condition, self.run, self.range, self.status, self.off * keep, self.heard & keep
        )

    def links(self, ping: Ping) -> Floats:
        """Return what the network is told of it, (n, LINKS): all zero before the first ping."""
        step = _condition(ping) - self.condition
        told = [
            np.ones(len(ping)),
            np.log1p(np.clip(step[4], 0.0, 100.0)) / 4.0,
            np.arcsinh(step[0] / UNIT_M) / 7.0,
            *np.tanh(20.0 * step[1:4]),
            *(self.status == kind for kind in EchoStatus),
            np.arcsinh(self.off / UNIT_M) / 7.0,
            np.clip(self.off / 0.05, -1.0, 1.0),
            self.heard,
        ]
        return (np.stack(told) * self.known).T

    def anchors(self, distance: Floats) -> Floats:
        """Return about what the anchored components lie, m, (ANCHORS, n)."""
        stuck = self.known & (self.status == EchoStatus.ECHO)
        return np.stack([distance + self.off, np.where(stuck, self.range, distance)])


def _condition(ping: Ping) -> Floats:
    return np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.time])


@dataclass
class State:
    """Memory of n sensors.

    Attributes:
        before: what was known before each one's last ping.
        condition, run: of that ping, (5, n) and (n,).
        fired: whether there was one, (n,) bool.
        hidden, cell: of the LSTM, (hidden, n).
    """

    before: Before
    condition: Floats
    run: NDArray[np.int64]
    fired: NDArray[np.bool_]
    hidden: Floats
    cell: Floats

    @classmethod
    def empty(cls, n: int, hidden: int) -> State:
        """Return the memory of n sensors that have not pinged yet."""
        zero = np.zeros((2, hidden, n))
        return cls(Before.nothing(n), np.zeros((5, n)), np.zeros(n, np.int64), np.zeros(n, dtype=bool), *zero)

    def __len__(self) -> int:
        return len(self.run)

    def __getitem__(self, rows: Any) -> State:
        """Return the memory of some of the sensors."""
        return State(self.before[rows], *(getattr(self, f.name)[..., rows] for f in fields(self)[1:]))

    def put(self, rows: NDArray[np.int64], other: State) -> None:
        """Put the memory of some of the sensors in its place."""
        for mine, new in ((self.before, other.before), (self, other)):
            for f in fields(mine):
                if f.name != "before":
                    getattr(mine, f.name)[..., rows] = getattr(new, f.name)

    def after(self, past: Reading, run: NDArray[np.int64] | None) -> State:
        """Return the memory with the last reading of each taken in; who is in another run now has none."""
        anew = ~self.fired if run is None else ~self.fired | (self.run != run)
        before = self.before.then(self.condition, self.run, past).without(anew)
        return replace(self, before=before, hidden=self.hidden * ~anew, cell=self.cell * ~anew)


@dataclass(frozen=True)
class Cell:
    """An LSTM's weights (Hochreiter and Schmidhuber 1997, gates as in torch): input, forget, cell, output.

    Attributes:
        on_input: (4 hidden, in).
        on_hidden: (4 hidden, hidden).
        bias: (4 hidden,).
    """

    on_input: Floats
    on_hidden: Floats
    bias: Floats

    @property
    def hidden(self) -> int:
        """Width of the state."""
        return self.on_hidden.shape[1]

    def step(self, x: Floats, hidden: Floats, cell: Floats) -> tuple[Floats, Floats]:
        """Return hidden state and cell after one more input, (n, in)."""
        z = x @ self.on_input.T + hidden @ self.on_hidden.T + self.bias
        take, keep, new, show = np.split(z, 4, axis=1)
        cell = expit(keep) * cell + expit(take) * np.tanh(new)
        return expit(show) * np.tanh(cell), cell


class LstmModel:
    """An LSTM over the pings of each sensor, whose state and the ping's condition a perceptron turns into a law.

    Args:
        inputs: what the network is told of a condition.
        head: how its numbers are read.
        cell: the LSTM.
        layers: of the perceptron behind it.
        base: whose numbers are corrected, in the hybrid.
        about: plain data on its making, kept in model.json.
        card: text of the folder's README.md.
    """

    remembers = True

    def __init__(
        self,
        inputs: Inputs,
        head: Head,
        cell: Cell,
        layers: Layers,
        base: MlpModel | None = None,
        about: dict[str, Any] | None = None,
        card: str = "",
    ) -> None:
        self.inputs, self.head, self.base, self.about, self.card = inputs, head, base, about or {}, card
        self.cell = Cell(*(np.asarray(x, dtype=np.float64) for x in (cell.on_input, cell.on_hidden, cell.bias)))
        self.layers = [(w.astype(np.float64), b.astype(np.float64)) for w, b in layers]
        self._place = None if base is None else head.places_of(base.head)
        self._state: State | None = None

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.head.resolution

    def fresh(self) -> LstmModel:
        """Return the same model with a memory of its own, empty."""
        return LstmModel(self.inputs, self.head, self.cell, self.layers, self.base, self.about, self.card)

    def reset(self, seats: ArrayLike | None = None) -> None:
        """Forget everything, or what some sensors remember: their numbers, or a mask."""
        if seats is None or self._state is None:
            self._state = None
            return
        rows = np.flatnonzero(seats) if np.asarray(seats).dtype == bool else np.asarray(seats)
        rows = rows[rows < len(self._state)]  # who has not pinged yet has nothing to forget
        self._state.put(rows, State.empty(len(rows), self.cell.hidden))

    def law(self, ping: Ping, past: Reading | None = None, seats: NDArray[np.int64] | None = None) -> MixtureLaw:
        """Return the law of the next ping of each of n sensors, and remember that it was fired.

        Args:
            ping: what each faces now.
            past: what each read last; None begins anew for all of them.
            seats: which of the sensors remembered each is, (n,), where only some fire at a time; only `reset` makes
                them forget then. Without, the n are all, and whoever is in another run than at its last ping begins
                anew.

        Raises:
            SettingError: without seats, there are more or fewer sensors than before.
        """
        places = np.arange(len(ping)) if seats is None else seats
        state = self._seated(len(ping), past, seats)
        here = State.empty(len(ping), self.cell.hidden)
        if past is not None:
            here = state[places].after(past, ping.run if seats is None else None)
        law, now = self._next(ping, here)
        state.put(places, now)
        self._state = state
        return law

    def _seated(self, n: int, past: Reading | None, seats: NDArray[np.int64] | None) -> State:
        """Return the memory with a place for everyone."""
        known = 0 if self._state is None else len(self._state)
        if seats is None and past is not None and known and not n == len(past) == known:
            raise SettingError(
                f"{n} pings and {len(past)} readings for a memory of {known} sensors: "
                "call reset() before another number of sensors, or take fresh()"
            )
        wanted = n if seats is None else max(known, int(seats.max(initial=-1)) + 1)
        if self._state is not None and wanted == known:
            return self._state
        grown = State.empty(wanted, self.cell.hidden)
        if self._state is not None and seats is not None:
            grown.put(np.arange(known), self._state)
        return grown

    def _next(self, ping: Ping, here: State) -> tuple[MixtureLaw, State]:
        asked, links = self.inputs.features(ping), here.before.links(ping)
        told = np.concatenate([asked.feature, links], axis=1)
        hidden, cell = self.cell.step(told, here.hidden.T, here.cell.T)
        law = self._law(asked, told, hidden, here.before.anchors(ping.distance))
        fired = np.ones(len(ping), dtype=bool)
        return law, State(here.before, _condition(ping), ping.run, fired, hidden.T, cell.T)

    def _law(self, asked: Asked, told: Floats, hidden: Floats, anchors: Floats) -> MixtureLaw:
        numbers = dense(self.layers, np.concatenate([told, hidden], axis=1))
        if self.base is not None:
            numbers[:, self._place] += dense(self.base.layers, asked.feature)
        return self.head.law(numbers, asked, anchors)

    def follow(self, ping: Ping, reading: Reading) -> MixtureLaw:
        """Return the law of every ping of a recording given all pings before it in its run, (n,)."""
        asked, before = self.inputs.features(ping), Before.each(ping, reading)
        told = np.concatenate([asked.feature, before.links(ping)], axis=1)
        return self._law(asked, told, self._hidden(told, ping.run), before.anchors(ping.distance))

    def _hidden(self, told: Floats, run: NDArray[np.int64]) -> Floats:
        """Return the hidden state at each ping, all runs side by side, (n, hidden)."""
        names, number = np.unique(run, return_inverse=True)
        out = np.zeros((len(run), self.cell.hidden))
        hidden, cell = np.zeros((2, len(names), self.cell.hidden))
        for rows in steps(run):
            place = number[rows]
            hidden[place], cell[place] = self.cell.step(told[rows], hidden[place], cell[place])
            out[rows] = hidden[place]
        return out

    @property
    def sizes(self) -> list[int]:
        """Widths of the perceptron's layers, its input first."""
        return [self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers)]

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the weights as plain data."""
        base = None if self.base is None else {"sizes": self.base.sizes, "head": asdict(self.base.head)}
        return {
            "kind": "lstm",
            "hidden": self.cell.hidden,
            "sizes": self.sizes,
            "inputs": asdict(self.inputs),
            "head": asdict(self.head),
            "base": base,
            "about": self.about,
        }

    def write_weights(self, folder: Path) -> None:
        """Write the weights, and the card where there is one, into a folder."""
        tensors = {f"lstm.{f.name}": getattr(self.cell, f.name) for f in fields(self.cell)}
        tensors |= tensors_of(self.layers)
        if self.base is not None:
            tensors |= tensors_of(self.base.layers, "base.")
        write_tensors(folder, tensors, self.card)

    @classmethod
    def load(cls, folder: Path, data: dict[str, Any]) -> LstmModel:
        """Read a saved network.

        Args:
            folder: that holds the weights.
            data: its model.json.

        Raises:
            ModelError: model.json or the weights are damaged, or belong to something else.
        """
        shape = Shape.read(folder, data)
        tensors, text = read_tensors(folder, shape.tensors)
        cell = Cell(*(tensors[f"lstm.{f.name}"] for f in fields(Cell)))
        layers = layers_of(tensors, len(shape.sizes) - 1)
        base = None
        if shape.base is not None:
            base_head, base_sizes = shape.base
            base = MlpModel(shape.inputs, base_head, layers_of(tensors, len(base_sizes) - 1, "base."))
        return cls(shape.inputs, shape.head, cell, layers, base, data.get("about", {}), text)


@dataclass(frozen=True)
class Shape:
    """What model.json says of an LSTM: inputs, head, widths, and head and widths of the base if there is one."""

    inputs: Inputs
    head: Head
    hidden: int
    sizes: list[int]
    base: tuple[Head, list[int]] | None

    @classmethod
    def read(cls, folder: Path, data: dict[str, Any]) -> Shape:
        """Check model.json.

        Raises:
            ModelError: it describes no such network.
        """
        path = folder / "model.json"
        try:
            inputs, head = Inputs.from_dict(data["inputs"]), Head(**data["head"])
            hidden, sizes = int(data["hidden"]), [int(size) for size in data["sizes"]]
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ModelError(f"{path}: does not describe a network ({error}); train it anew") from None
        wanted = inputs.width + LINKS + hidden
        if len(sizes) < 2 or sizes[0] != wanted or sizes[-1] != head.width or head.anchored != ANCHORS or hidden < 1:
            raise ModelError(f"{path}: layers {sizes} do not lead from {wanted} to {head.width} numbers; train it anew")
        given = data.get("base")
        base = None if given is None else read_shape(folder, {**given, "inputs": data["inputs"]})[1:]
        if base is not None and (base[0].near, base[0].fixed) != (head.near, head.fixed):
            raise ModelError(f"{path}: the base has other components than the head; train it anew")
        return cls(inputs, head, hidden, sizes, base)

    @property
    def tensors(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of all weights."""
        gates, told = 4 * self.hidden, self.inputs.width + LINKS
        out = {"lstm.on_input": (gates, told), "lstm.on_hidden": (gates, self.hidden), "lstm.bias": (gates,)}
        out |= shapes_of(self.sizes)
        return out if self.base is None else out | shapes_of(self.base[1], "base.")
