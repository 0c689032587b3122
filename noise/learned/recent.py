"""Credence given the last few readings of a sensor, without knowledge of the condition.

P(the true distance is within +-10 % of this reading | this reading and the earlier ones of its run), by a perceptron
trained on recordings; the prior over conditions is that of the recordings, including their order. A reading that
agrees with its predecessors has a higher credence than the same reading alone, an outlier a lower one.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition import ModelError, Ping, Reading
from acquisition.arrays import Floats
from acquisition.io.schema import read_json
from noise.learned.networks import dense
from noise.learned.tensors import Layers, layers_of, read_tensors, shapes_of, tensors_of, write_tensors
from noise.model import steps
from noise.schema import Credence

ABOUT_FILE = "credence.json"
N_FEATURES = 7  # per reading
RANGE_SCALE_M = 6.0  # scale of ranges; chosen here
DIFFERENCE_SCALE_M = 0.01  # scale of differences; chosen here
FORMAT = 1


@dataclass
class RecentReadings:
    """The last k readings of n sensors, newest first, (k, n) each.

    Attributes:
        known: whether there was such a ping, bool.
        echo, lost: whether it gave an echo, or no answer, bool.
        range: range reading, m; 0 without an echo.
        time: time of the ping, s.
    """

    known: NDArray[np.bool_]
    echo: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    range: Floats
    time: Floats

    @classmethod
    def empty(cls, depth: int, n: int) -> RecentReadings:
        """Return the readings of n sensors before their first ping."""
        no, zero = np.zeros((depth, n), dtype=bool), np.zeros((depth, n))
        return cls(no, no, no, zero, zero)

    @classmethod
    def of_recording(cls, depth: int, ping: Ping, reading: Reading) -> RecentReadings:
        """Return the last readings at each ping of a recording, including its own, (depth, n)."""
        place, order = np.empty(len(ping), dtype=np.int64), np.argsort(ping.run, kind="stable")
        for k, rows in enumerate(steps(ping.run)):
            place[rows] = k
        at = np.empty(len(ping), dtype=np.int64)
        at[order] = np.arange(len(ping))
        back = np.arange(depth)[:, None]
        row = order[np.maximum(at - back, 0)]
        known = place >= back
        answered, echo = reading.answered[row], reading.echo[row]
        return cls(known, known & echo, known & ~answered, known * reading.range[row], known * ping.time[row])

    def updated(self, reading: Reading, time: Floats) -> RecentReadings:
        """Return the last readings after one more reading of each sensor."""
        new = (np.ones(len(reading), dtype=bool), reading.echo, ~reading.answered, reading.range, time)
        return RecentReadings(*(np.concatenate([x[None], getattr(self, f.name)[:-1]])
                        for x, f in zip(new, fields(self), strict=True)))  # fmt: skip

    def cleared(self, rows: NDArray[np.bool_]) -> RecentReadings:
        """Return the last readings with those of some sensors cleared, (n,) bool."""
        return RecentReadings(*(getattr(self, f.name) * ~rows for f in fields(self)))

    def features(self) -> Floats:
        """Return the features for the network, (n, depth * N_FEATURES)."""
        apart = np.arcsinh((self.range - self.range[0]) / DIFFERENCE_SCALE_M) / 7.0
        features = [
            self.known,
            self.echo,
            self.lost,
            self.echo * np.log((self.range + 0.02) / RANGE_SCALE_M),
            self.echo * (4.0 * self.range / RANGE_SCALE_M - 1.0),
            self.echo * apart,
            self.known * np.log1p(np.clip(self.time[0] - self.time, 0.0, 100.0)) / 4.0,
        ]
        return np.stack(features, axis=-1).astype(np.float64).transpose(1, 0, 2).reshape(self.known.shape[1], -1)


@dataclass(frozen=True)
class RecentCredence:
    """Learned credence given the last readings.

    Attributes:
        depth: number of readings used, including the current one.
        layers: layers of the perceptron.
        about: plain data on the training.
        card: text of the folder's README.md.
    """

    depth: int
    layers: Layers
    about: dict[str, Any]
    card: str = ""

    def given(self, recent: RecentReadings) -> Floats:
        """Return the credence of the newest reading of each sensor, (n,); 0 without an echo."""
        logit = dense(self.layers, recent.features())[:, 0]
        return np.where(recent.echo[0], 1.0 / (1.0 + np.exp(-logit)), 0.0)

    def follow(self, ping: Ping, reading: Reading) -> Floats:
        """Return the credence of every reading of a recording given the earlier ones of its run, (n,)."""
        return self.given(RecentReadings.of_recording(self.depth, ping, reading))

    @property
    def sizes(self) -> list[int]:
        """Widths of all layers, the input first."""
        return [self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers)]

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write the network to a folder and return the folder."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        write_tensors(folder, tensors_of(self.layers), self.card)
        text = json.dumps({"format": FORMAT, "depth": self.depth, "sizes": self.sizes, "about": self.about}, indent=2)
        (folder / ABOUT_FILE).write_text(text + "\n", encoding="utf-8")
        return folder

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> RecentCredence:
        """Load a network from a folder.

        Raises:
            ModelError: the folder contains no learned credence, or a damaged one.
        """
        path = Path(folder) / ABOUT_FILE
        data = read_json(path, Credence)
        depth, sizes = data["depth"], data["sizes"]
        if sizes[0] != depth * N_FEATURES or sizes[-1] != 1:
            raise ModelError(f"{path}: layers {sizes} do not map {depth} readings to one output; train the model again")
        tensors, card = read_tensors(Path(folder), shapes_of(sizes))
        return cls(depth, layers_of(tensors, len(sizes) - 1), data.get("about", {}), card)
