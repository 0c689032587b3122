"""Echo paths, each with a length and an amplitude, in groups that fluctuate together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.arrays import Floats, Ints

Complexes = NDArray[np.complex128]
LEAK, FACE, BOUNCE, POST, FLOOR, CEILING, WALL, SIDES, CLUTTER, OTHER = range(10)
GROUPS = ("leak", "face", "bounce", "post", "floor", "ceiling", "wall", "sides", "clutter", "other")


@dataclass(frozen=True)
class Arrivals:
    """Echo paths of n scenes.

    Attributes:
        row: index of the scene, (k,).
        group: index into `GROUPS`, (k,).
        length: half of the path length, m, (k,).
        amplitude: pressure relative to that at 1 m on the transmitter's axis, without absorption, (k,).
    """

    row: Ints
    group: Ints
    length: Floats
    amplitude: Complexes

    @classmethod
    def of(cls, row: ArrayLike, group: ArrayLike, length: ArrayLike, amplitude: ArrayLike) -> Arrivals:
        """Build from lengths and amplitudes, (m,) or (m, k), of m scenes, omitting paths of zero amplitude.

        Args:
            row: indices of the scenes, (m,).
            group: index into `GROUPS`, one for all or (m,).
            length: m, broadcast against the amplitudes.
            amplitude: broadcast against the lengths.
        """
        length, amplitude = np.broadcast_arrays(length, amplitude)
        owner = np.nonzero(amplitude)
        rows = np.asarray(row, dtype=np.int64)[owner[0]]
        number = np.broadcast_to(group, (len(length),))[owner[0]]
        return cls(rows, number, length[owner].astype(np.float64), amplitude[owner].astype(np.complex128))

    @classmethod
    def joined(cls, parts: Iterable[Arrivals]) -> Arrivals:
        """Concatenate several sets of paths."""
        parts = list(parts)
        if not parts:
            return cls(*(np.empty(0, dtype=t) for t in (np.int64, np.int64, np.float64, np.complex128)))  # type: ignore[arg-type]
        names = ("row", "group", "length", "amplitude")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def __len__(self) -> int:
        """Return the number of paths."""
        return len(self.row)

    def __getitem__(self, pick: NDArray[np.generic] | slice) -> Arrivals:
        """Return the paths selected by a mask or by indices."""
        return Arrivals(self.row[pick], self.group[pick], self.length[pick], self.amplitude[pick])

    def only(self, group: int) -> Arrivals:
        """Return the paths of one group."""
        return self[self.group == group]
