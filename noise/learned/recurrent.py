"""Learned laws with memory: an LSTM over the pings of a sensor, alone or as a correction of a perceptron (hybrid).

The inputs at a ping are its condition, the condition and reading of the last ping, and the difference of the two
conditions. The state summarises all earlier pings: the errors of this sensor, the true position of the reflector, a
loose wire. Two components lie about the last reading: the last echo shifted with the reflector, since its error
persists, and the last reading unchanged, for a register that repeats.

`LstmModel.law` advances the state, so that a model serves one set of sensors; `fresh()` returns a copy with the same
weights and an empty state. Pings without a past, or of another run, start from an empty state.
"""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition import Ping, Reading, SettingError
from acquisition.arguments import checked
from acquisition.arrays import Floats, Ints
from acquisition.limits import shown
from acquisition.ping import check_pairs
from noise.learned.inputs import FeatureBatch, Inputs
from noise.learned.mixture import Head, MixtureLaw
from noise.learned.networks import WARNED, WARNED_UNKNOWN, MlpModel, dense, of_distance, read_about
from noise.learned.recurrent_file import LstmShape
from noise.learned.recurrent_state import LstmCell, LstmState, PingHistory, condition_of
from noise.learned.tensors import Layers, as_layers, layers_of, read_tensors, tensors_of, write_tensors
from noise.model import steps

MAX_SENSORS = 1_000_000


def _places(sensors: Ints, n: int) -> Ints:
    """Return the indices of sensors; raise SettingError unless there is one for each ping."""
    if sensors.shape != (n,) or not np.all((sensors >= 0) & (sensors < MAX_SENSORS)):
        raise SettingError(f"sensors: expected {n} numbers from 0 to {MAX_SENSORS - 1}, got {shown(sensors)}")
    return sensors


class LstmModel:
    """An LSTM over the pings of each sensor; a perceptron maps its state and the ping's condition to a law.

    Args:
        inputs: features of a condition.
        head: interpretation of the outputs as a law.
        cell: weights of the LSTM.
        layers: layers of the perceptron.
        base: network whose outputs are corrected, in the hybrid.
        about: plain data on the training, stored in model.json.
        card: text of the folder's README.md.
    """

    remembers = True

    @checked
    def __init__(
        self,
        inputs: Inputs,
        head: Head,
        cell: LstmCell,
        layers: Layers,
        base: MlpModel | None = None,
        about: dict[str, object] | None = None,
        card: str = "",
    ) -> None:
        self.inputs, self.head, self.base, self.about, self.card = inputs, head, base, about or {}, card
        self.cell = LstmCell(*(np.asarray(x, dtype=np.float64) for x in (cell.on_input, cell.on_hidden, cell.bias)))
        self.layers = as_layers("LstmModel.layers", layers)
        self._base_columns = None if base is None else head.indices_of(base.head)
        self._state: LstmState | None = None

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.head.resolution

    def fresh(self) -> LstmModel:
        """Return the same model with an empty state of its own."""
        model = LstmModel(self.inputs, self.head, self.cell, self.layers, self.base, self.about, self.card)
        for warned in (WARNED, WARNED_UNKNOWN):
            if self in warned:
                warned.add(model)
        return model

    def reset(self, sensors: ArrayLike | None = None) -> None:
        """Clear the state of all sensors, or of those given by index or mask."""
        if sensors is None or self._state is None:
            self._state = None
            return
        given = np.asarray(sensors)
        rows = np.flatnonzero(given) if given.dtype == bool else given.astype(np.int64)
        rows = rows[rows < len(self._state)]  # sensors without a ping have no state yet
        self._state.put(rows, LstmState.empty(len(rows), self.cell.hidden))

    @checked
    def law(self, ping: Ping, past: Reading | None = None, sensors: NDArray[np.int64] | None = None) -> MixtureLaw:
        """Return the law of the next ping of each of n sensors, and advance the state.

        Args:
            ping: conditions, (n,).
            past: last readings, (n,); None starts from an empty state.
            sensors: index of each ping's sensor, (n,), if only some of the sensors fire; their state is then cleared
                only by `reset`. By default the n pings are those of all sensors, and a sensor in another run than at
                its last ping starts from an empty state.

        Raises:
            SettingError: without `sensors`, the number of sensors differs from that of the last call.
        """
        check_pairs("LstmModel.law.past", ping, past)
        places = np.arange(len(ping)) if sensors is None else _places(sensors, len(ping))
        state = self._resized(len(ping), past, sensors)
        current = LstmState.empty(len(ping), self.cell.hidden)
        if past is not None:
            current = state[places].after(past, ping.run if sensors is None else None)
        known = self.inputs.equivalent(ping)
        law, advanced = self._next(known, current)
        state.put(places, advanced)
        self._state = state
        return of_distance(self, law, ping, known)

    def _resized(self, n: int, past: Reading | None, sensors: NDArray[np.int64] | None) -> LstmState:
        """Return the state with room for all sensors."""
        known = 0 if self._state is None else len(self._state)
        if sensors is None and past is not None and known and not n == len(past) == known:
            raise SettingError(
                f"{n} pings and {len(past)} readings for a state of {known} sensors: "
                "call reset() before a change of the number of sensors, or use fresh()"
            )
        wanted = n if sensors is None else max(known, int(sensors.max(initial=-1)) + 1)
        if self._state is not None and wanted == known:
            return self._state
        grown = LstmState.empty(wanted, self.cell.hidden)
        if self._state is not None and sensors is not None:
            grown.put(np.arange(known), self._state)
        return grown

    def _next(self, ping: Ping, current: LstmState) -> tuple[MixtureLaw, LstmState]:
        batch = self.inputs.features(ping)
        x = np.concatenate([batch.feature, current.history.features(ping)], axis=1)
        hidden, cell = self.cell.step(x, current.hidden.T, current.cell.T)
        law = self._law(batch, x, hidden, current.history.anchors(ping.distance))
        fired = np.ones(len(ping), dtype=bool)
        return law, LstmState(current.history, condition_of(ping), ping.run, fired, hidden.T, cell.T)

    def _law(self, batch: FeatureBatch, x: Floats, hidden: Floats, anchors: Floats) -> MixtureLaw:
        outputs = dense(self.layers, np.concatenate([x, hidden], axis=1))
        if self.base is not None:
            outputs[:, self._base_columns] += dense(self.base.layers, batch.feature)
        return self.head.law(outputs, batch, anchors)

    @checked
    def follow(self, ping: Ping, reading: Reading) -> MixtureLaw:
        """Return the law of every ping of a recording given all earlier pings of its run, (n,)."""
        check_pairs("LstmModel.follow.reading", ping, reading)
        known = self.inputs.equivalent(ping)
        batch, history = self.inputs.features(known), PingHistory.of_recording(known, reading)
        x = np.concatenate([batch.feature, history.features(known)], axis=1)
        law = self._law(batch, x, self._hidden(x, ping.run), history.anchors(known.distance))
        return of_distance(self, law, ping, known)

    def _hidden(self, x: Floats, run: NDArray[np.int64]) -> Floats:
        """Return the hidden state at each ping, with all runs in parallel, (n, hidden)."""
        names, number = np.unique(run, return_inverse=True)
        out = np.zeros((len(run), self.cell.hidden))
        hidden, cell = np.zeros((2, len(names), self.cell.hidden))
        for rows in steps(run):
            place = number[rows]
            hidden[place], cell[place] = self.cell.step(x[rows], hidden[place], cell[place])
            out[rows] = hidden[place]
        return out

    @property
    def sizes(self) -> list[int]:
        """Widths of the perceptron's layers, the input first."""
        return [self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers)]

    def to_dict(self) -> dict[str, object]:
        """Return everything but the weights as plain data."""
        base = None if self.base is None else {"sizes": self.base.sizes, "head": asdict(self.base.head)}
        return {
            "kind": "lstm",
            "hidden": self.cell.hidden,
            "sizes": self.sizes,
            "inputs": self.inputs.to_dict(),
            "head": asdict(self.head),
            "base": base,
            "about": self.about,
        }

    @checked
    def write_weights(self, folder: Path) -> None:
        """Write the weights, and the card if there is one, into a folder."""
        tensors = {f"lstm.{f.name}": getattr(self.cell, f.name) for f in fields(self.cell)}
        tensors |= tensors_of(self.layers)
        if self.base is not None:
            tensors |= tensors_of(self.base.layers, "base.")
        write_tensors(folder, tensors, self.card)

    @classmethod
    @checked
    def load(cls, folder: Path, data: dict[str, object]) -> LstmModel:
        """Load a saved network.

        Args:
            folder: folder with the weights.
            data: contents of model.json.

        Raises:
            ModelError: model.json or the weights are damaged or do not match.
        """
        shape = LstmShape.read(folder, data)
        tensors, text = read_tensors(folder, shape.tensors)
        cell = LstmCell(*(tensors[f"lstm.{f.name}"] for f in fields(LstmCell)))
        layers = layers_of(tensors, len(shape.sizes) - 1)
        base = None
        if shape.base is not None:
            base_head, base_sizes = shape.base
            base = MlpModel(shape.inputs, base_head, layers_of(tensors, len(base_sizes) - 1, "base."))
        return cls(shape.inputs, shape.head, cell, layers, base, read_about(data), text)
