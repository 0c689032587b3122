"""Credence surfaces: of what the sonar read, and of what networks map its readings to (thesis, figures 4.1 to 5.1).

A mapped reading is right where it lies within 10 % of the true distance. A network answers silence too, with about the
distance at which the silent pings of that angle and reflector were made, and is then right wherever that happens to be
so. `SILENCE_READ` does the same without a network, so that one sees what was learnt of readings and what of silence.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from training.thesis.data import READING_M, Floats, Samples, Singles, credence_of, metres
from training.thesis.networks import Network

MIRROR, RUBBER = "mirror", "rubber"
READINGS, SILENCE_READ = "readings", "readings, silence taken for its mean distance at that angle and reflector"
SHORT_M = 0.5  # "close ranges (less than 500mm)", thesis section 4.1


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Credence of each condition of a survey.

    Attributes:
        samples: all pings.
        networks: weights by name of the network, one vector a seed.
    """

    samples: Samples
    networks: dict[str, tuple[Network, list[Singles]]]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """What there are surfaces of."""
        return READINGS, SILENCE_READ, *self.networks

    @cached_property
    def credence(self) -> dict[str, Floats]:
        """Credence of each condition, (seeds, cells); one row for what has no seed."""
        heard = self.samples.feature[:, 2].astype(np.float64) * READING_M
        guess = np.where(heard > 0, heard, self._silent_distance(heard == 0.0))
        mapped = {name: self._mapped(*pair) for name, pair in self.networks.items()}
        return {READINGS: self._credence(heard)[None], SILENCE_READ: self._credence(guess)[None], **mapped}

    def _silent_distance(self, silent: NDArray[np.bool_]) -> Floats:
        """Return the mean distance of the silent pings of each ping's angle and reflector, m, (n,); 0 where none is."""
        place = np.unique(self.samples.feature[:, :2], axis=0, return_inverse=True)[1]
        total, count = np.bincount(place, silent * self.samples.distance), np.bincount(place, silent)
        return (total / np.maximum(count, 1.0))[place]

    def _mapped(self, network: Network, weights: list[Singles]) -> Floats:
        said = (metres(network.predict(theta, self.samples.feature)) for theta in weights)
        return np.array([self._credence(one) for one in said])

    def _credence(self, said: Floats) -> Floats:
        return credence_of(said, self.samples.distance, self.samples.condition)

    @cached_property
    def _first(self) -> NDArray[np.int64]:
        return np.unique(self.samples.condition, return_index=True)[1]

    @cached_property
    def distance(self) -> Floats:
        """Distance of each condition, m, (cells,)."""
        return self.samples.distance[self._first]

    @cached_property
    def angle(self) -> Floats:
        """Angle of each condition, degrees, (cells,)."""
        return 45.0 * self.samples.feature[self._first, 0].astype(np.float64)

    def of(self, reflector: str) -> NDArray[np.bool_]:
        """Return which conditions had the mirror, or the rubber, before the sensor, (cells,)."""
        high = self.samples.feature[self._first, 1] > 0.5
        return high if reflector == MIRROR else ~high

    @cached_property
    def silent(self) -> NDArray[np.bool_]:
        """Which conditions gave no echo at all, (cells,)."""
        cell = self.samples.condition
        return np.bincount(cell, self.samples.feature[:, 2]) == 0.0

    def mean(self, name: str, cells: NDArray[np.bool_]) -> Floats:
        """Return the mean credence over some conditions, (seeds,); nan where there are none."""
        return self.credence[name][:, cells].mean(axis=1) if cells.any() else np.full(1, np.nan)
