"""Credence given the last few readings of a sensor: what a robot can know without knowing what it faces.

P(the true distance is within +-10 % of this reading | this reading and those before it in its run), by a perceptron
that learned it from recordings: the prior over conditions is that of what was recorded, sequence and all. A reading
that agrees with its neighbours, or breaks with them, is believed more or less than the same reading alone.
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
from noise.law import Floats
from noise.learned.networks import dense
from noise.learned.tensors import Layers, layers_of, read_tensors, shapes_of, tensors_of, write_tensors
from noise.model import steps

ABOUT_FILE = "credence.json"
EACH = 7  # numbers a reading is told by
FAR_M = 6.0  # m; scale of ranges, ours
CLOSE_M = 0.01  # m; scale of differences, ours
FORMAT = 1


@dataclass
class Recent:
    """The last k readings of n sensors, newest first, (k, n) each.

    Attributes:
        known: whether there was such a ping, bool.
        echo, lost: whether it gave an echo, or no answer, bool.
        range: m; 0 without an echo.
        time: of the ping, s.
    """

    known: NDArray[np.bool_]
    echo: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    range: Floats
    time: Floats

    @classmethod
    def nothing(cls, depth: int, n: int) -> Recent:
        """Return the memory of n sensors that have not pinged yet."""
        no, zero = np.zeros((depth, n), dtype=bool), np.zeros((depth, n))
        return cls(no, no, no, zero, zero)

    @classmethod
    def each(cls, depth: int, ping: Ping, reading: Reading) -> Recent:
        """Return the last readings at each ping of a recording, its own first, (depth, n)."""
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

    def then(self, reading: Reading, time: Floats) -> Recent:
        """Return the memory after one more reading of each sensor."""
        new = (np.ones(len(reading), dtype=bool), reading.echo, ~reading.answered, reading.range, time)
        return Recent(*(np.concatenate([x[None], getattr(self, f.name)[:-1]])
                        for x, f in zip(new, fields(self), strict=True)))  # fmt: skip

    def without(self, rows: NDArray[np.bool_]) -> Recent:
        """Return the memory with some sensors' emptied, (n,) bool."""
        return Recent(*(getattr(self, f.name) * ~rows for f in fields(self)))

    def features(self) -> Floats:
        """Return what a network is told, (n, depth * EACH)."""
        apart = np.arcsinh((self.range - self.range[0]) / CLOSE_M) / 7.0
        told = [
            self.known,
            self.echo,
            self.lost,
            self.echo * np.log((self.range + 0.02) / FAR_M),
            self.echo * (4.0 * self.range / FAR_M - 1.0),
            self.echo * apart,
            self.known * np.log1p(np.clip(self.time[0] - self.time, 0.0, 100.0)) / 4.0,
        ]
        return np.stack(told, axis=-1).astype(np.float64).transpose(1, 0, 2).reshape(self.known.shape[1], -1)


@dataclass(frozen=True)
class RecentCredence:
    """Credence given the last readings, learned.

    Attributes:
        depth: number of readings that are looked at, this one included.
        layers: of the perceptron.
        about: plain data on its making.
        card: text of the folder's README.md.
    """

    depth: int
    layers: Layers
    about: dict[str, Any]
    card: str = ""

    def given(self, recent: Recent) -> Floats:
        """Return the credence of the newest reading of each sensor, (n,); 0 where it is no echo."""
        logit = dense(self.layers, recent.features())[:, 0]
        return np.where(recent.echo[0], 1.0 / (1.0 + np.exp(-logit)), 0.0)

    def follow(self, ping: Ping, reading: Reading) -> Floats:
        """Return the credence of every reading of a recording given those before it in its run, (n,)."""
        return self.given(Recent.each(self.depth, ping, reading))

    @property
    def sizes(self) -> list[int]:
        """Widths of all layers, the input first."""
        return [self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers)]

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write it to a folder."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        write_tensors(folder, tensors_of(self.layers), self.card)
        text = json.dumps({"format": FORMAT, "depth": self.depth, "sizes": self.sizes, "about": self.about}, indent=2)
        (folder / ABOUT_FILE).write_text(text + "\n", encoding="utf-8")
        return folder

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> RecentCredence:
        """Read it from a folder.

        Raises:
            ModelError: the folder holds no such thing, or a damaged one.
        """
        path = Path(folder) / ABOUT_FILE
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            depth, sizes = int(data["depth"]), [int(size) for size in data["sizes"]]
        except FileNotFoundError:
            raise ModelError(f"{folder}: holds no {ABOUT_FILE}; give the folder of a learned credence") from None
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"{path}: does not describe a credence ({error}); it may be damaged") from None
        if data.get("format") != FORMAT or len(sizes) < 2 or sizes[0] != depth * EACH or sizes[-1] != 1 or depth < 1:
            raise ModelError(f"{path}: layers {sizes} do not lead from {depth} readings to one number")
        tensors, card = read_tensors(Path(folder), shapes_of(sizes))
        return cls(depth, layers_of(tensors, len(sizes) - 1), data.get("about", {}), card)
