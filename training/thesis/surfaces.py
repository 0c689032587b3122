"""Credence surfaces of readings and of distances estimated by networks (thesis, figures 4.1 to 5.1).

An estimate is right if it lies within 10 % of the true distance. For a ping without echo a network outputs about the
mean distance of such pings at the same angle and reflector, which is right wherever the reflector happens to be near
that distance. `SUBSTITUTED` does the same without a network, which separates the effect of readings from that of
missing echoes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from training.common.canvas import Axes, Draw, panels
from training.thesis.data import Bits, Floats, Samples, Singles, credence_of, group_mean, metres
from training.thesis.networks import FlatNetwork

MIRROR, RUBBER = "mirror", "rubber"
READINGS, SUBSTITUTED = "readings", "readings, no echo replaced by its mean distance at that angle and reflector"
SHORT_RANGE = 0.5  # m; "close ranges (less than 500mm)", thesis section 4.1
PANELS = {READINGS: "readings", "MLP": "mapped by MLP", "LSTM": "mapped by LSTM"}


@dataclass(frozen=True, eq=False)
class CredenceSurfaces:
    """Credence of each condition of a survey.

    Attributes:
        samples: all pings.
        networks: architecture and weights of each seed, by name of the network.
    """

    samples: Samples
    networks: dict[str, tuple[FlatNetwork, list[Singles]]]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the surfaces."""
        return READINGS, SUBSTITUTED, *self.networks

    @cached_property
    def credence(self) -> dict[str, Floats]:
        """Credence of each condition, (seeds, conditions); one row for surfaces without a network."""
        measured = self.samples.range
        substituted = np.where(measured > 0, measured, self._silent_distance(measured == 0.0))
        mapped = {name: self._mapped(*pair) for name, pair in self.networks.items()}
        return {READINGS: self._of(measured)[None], SUBSTITUTED: self._of(substituted)[None], **mapped}

    def _silent_distance(self, silent: Bits) -> Floats:
        """Return the mean distance of pings without echo at each ping's angle and reflector, m, (n,)."""
        place = np.unique(self.samples.feature[:, :2], axis=0, return_inverse=True)[1]
        return group_mean(self.samples.distance[silent], place[silent], place.max() + 1)[place]

    def _mapped(self, network: FlatNetwork, weights: list[Singles]) -> Floats:
        return np.array([self._of(metres(network.predict(theta, self.samples.feature))) for theta in weights])

    def _of(self, estimate: Floats) -> Floats:
        return credence_of(estimate, self.samples.distance, self.samples.condition)

    @cached_property
    def _first(self) -> NDArray[np.int64]:
        """Row of the first ping of each condition."""
        return np.unique(self.samples.condition, return_index=True)[1]

    @cached_property
    def distance(self) -> Floats:
        """Distance of each condition, m, (conditions,)."""
        return self.samples.distance[self._first]

    @cached_property
    def angle(self) -> Floats:
        """Angle of each condition, degrees, (conditions,)."""
        return self.samples.angle_deg[self._first]

    def of(self, reflector: str) -> Bits:
        """Return which conditions have the mirror, or the rubber, as reflector, (conditions,)."""
        high = self.samples.feature[self._first, 1] > 0.5
        return high if reflector == MIRROR else ~high

    @cached_property
    def silent(self) -> Bits:
        """Which conditions have no echo at all, (conditions,)."""
        return np.bincount(self.samples.condition, self.samples.range) == 0.0

    def mean(self, name: str, conditions: Bits) -> Floats:
        """Return the mean credence over some conditions, (seeds,); nan if there are none."""
        return self.credence[name][:, conditions].mean(axis=1) if conditions.any() else np.full(1, np.nan)


def surfaces_figure(surfaces: CredenceSurfaces, reflectors: Sequence[str]) -> bytes:
    """Draw the credence of readings and of both networks' estimates as PNG, one row per reflector."""
    draws = [_surface(surfaces, key, r, f"{r}: {text}") for r in reflectors for key, text in PANELS.items()]
    size = (9.0, 2.8 * len(reflectors))
    return panels(draws, size, columns=len(PANELS), colours=("credence", 0.0, 1.0))


def _surface(surfaces: CredenceSurfaces, name: str, reflector: str, title: str) -> Draw:
    def draw(axes: Axes) -> None:
        chosen = surfaces.of(reflector)
        angle, distance, value = _grid(
            surfaces.angle[chosen], surfaces.distance[chosen], surfaces.credence[name][0, chosen]
        )
        a, d = np.meshgrid(np.deg2rad(np.clip(bin_edges(angle), 0.0, None)), bin_edges(distance), indexing="ij")
        axes.pcolormesh(d * np.cos(a), d * np.sin(a), value, vmin=0.0, vmax=1.0, cmap="viridis", rasterized=True)
        axes.set(aspect="equal", facecolor="#f4f5f7")
        axes.set_xlabel("along the axis (m)", fontsize=9)
        axes.set_ylabel("across the axis (m)", fontsize=9)
        axes.set_title(title, fontsize=9)
        axes.tick_params(labelsize=8)

    return draw


def _grid(angle: Floats, distance: Floats, value: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the angles, the distances and the value at each combination, nan where nothing was measured."""
    angles, row = np.unique(np.round(angle, 6), return_inverse=True)
    distances, column = np.unique(np.round(distance, 4), return_inverse=True)
    out = np.full((len(angles), len(distances)), np.nan)
    out[row, column] = value
    return angles, distances, out


def bin_edges(centre: Floats) -> Floats:
    """Return the edges of bins around increasing centres, halfway between neighbours, (n + 1,).

    >>> bin_edges(np.array([0.0, 1.0, 3.0]))
    array([-0.5,  0.5,  2. ,  4. ])
    """
    if len(centre) == 1:
        return centre[0] + np.array([-0.5, 0.5])
    half = np.diff(centre) / 2
    return np.concatenate([[centre[0] - half[0]], centre[:-1] + half, [centre[-1] + half[-1]]])
