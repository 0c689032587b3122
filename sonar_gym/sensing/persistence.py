"""The part of a reading's error that persists: standard normal numbers for a face, a sonar and an episode.

The error of a ping is a function of where the sensor and the reflector stand, so the same place gives the same error
again, and a movement changes it over a correlation length. The numbers are a sum of a constant and of plane waves with
random phases (Rahimi and Recht 2007, "Random features for large-scale kernel machines"), which needs no memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from acquisition.arrays import Floats, Ints
from noise.law import UniformSource
from noise.learned.persistence import Persistence
from sonar_gym.compiled import compiled
from sonar_gym.sensing.laws.numbers import mixed, normal_cdf, normal_quantile, to_unit
from sonar_gym.sensing.paths import BEARING, DISTANCE, FACE, INCIDENCE, TEXTURE, X, Y

WAVES = 6  # plane waves in a sum; their number limits the extremes of the sum, not its variance
WAVELENGTH_M = 0.0086  # of 40 kHz in air of 20 degC
_SCALES = np.array([0.4, 0.6, 1.0, 1.0, 1.6, 2.5])  # spread of the wavelengths, so that the correlation has no ripple
_VECTORS = np.random.default_rng(2016).standard_normal((64, 5))  # directions of the waves, shared by all faces
_TWO_PI = 2.0 * math.pi
LATENTS = 2  # numbers per path: one decides on an echo, one on its range


@compiled
def keys_of(episodes: Ints, sonars: Ints, count: int) -> Ints:
    """Return the number of the episode and sonar of each path, (m,).

    Args:
        episodes: number of the episode of each car, (n,).
        sonars: number of the sonar of each path among those of all cars, (m,).
        count: number of sonars on a car.
    """
    return np.asarray(episodes[sonars // count] + sonars % count)


@compiled
def latents(paths: Floats, keys: Ints, lasting: float, length: float) -> Floats:
    """Return standard normal numbers for paths, (LATENTS, m).

    Args:
        paths: paths of pings, see `paths.cast_paths`, (m, N_PATH).
        keys: number of the episode and sonar of each path, (m,).
        lasting: share of the variance that is constant.
        length: correlation length of the rest, m.
    """
    out = np.empty((LATENTS, paths.shape[0]))
    constant, moving = math.sqrt(lasting), math.sqrt((1.0 - lasting) * 2.0 / WAVES)
    for i in range(paths.shape[0]):
        path = paths[i]
        seed = mixed(np.uint64(keys[i]) + np.uint64(int(path[FACE]) + 2) * np.uint64(0x9E3779B97F4A7C15))
        first, second = to_unit(mixed(seed + np.uint64(1))), to_unit(mixed(seed + np.uint64(2)))
        radius, angle = math.sqrt(-2.0 * math.log(first)), _TWO_PI * second  # Box and Muller 1958
        out[0, i], out[1, i] = constant * radius * math.cos(angle), constant * radius * math.sin(angle)
        if lasting >= 1.0:
            continue
        along, aside, turn = path[DISTANCE], path[DISTANCE] * path[BEARING], path[DISTANCE] * path[INCIDENCE]
        # facets of slope t shift the paths by up to 2 t per metre: the pattern repeats within a quarter wavelength
        rough = 4.0 * math.sin(path[TEXTURE]) / WAVELENGTH_M
        for wave in range(WAVES):
            bits = mixed(seed + np.uint64(8 + wave))
            vector, scale = _VECTORS[int(bits & np.uint64(63))], _SCALES[wave]
            phase = (vector[0] * along + vector[1] * aside + vector[2] * turn) / (length * scale)
            if rough > 0.0:
                phase += rough * (vector[3] * path[X] + vector[4] * path[Y]) * scale
            phase += _TWO_PI * to_unit(bits)
            # a wave and the same a quarter of a period on are uncorrelated
            out[0, i] += moving * math.cos(phase)
            out[1, i] += moving * math.sin(phase)
    return out


@compiled
def persisting(new: Floats, latent: Floats, shares: tuple[float, float]) -> Floats:
    """Return uniform numbers with a persisting part, (LATENTS, m).

    Args:
        new: uniform numbers, (LATENTS, m).
        latent: the persisting normal numbers, (LATENTS, m).
        shares: share of the persisting part in the variance of each row.
    """
    out = np.empty_like(new)
    for row in range(new.shape[0]):
        held, drawn = math.sqrt(shares[row]), math.sqrt(1.0 - shares[row])
        for i in range(new.shape[1]):
            out[row, i] = normal_cdf(held * latent[row, i] + drawn * normal_quantile(new[row, i]))
    return out


class PersistentStream:
    """Uniform random numbers with a part that persists; see `noise.learned.persistence`.

    A law that takes two numbers per ping, for the outcome and for the range, gets both with their persisting parts;
    any other numbers are drawn anew.

    Args:
        stream: source of the numbers drawn at every ping.
        latent: the persisting normal numbers, (LATENTS, n).
        persistence: shares of the persisting part.
    """

    def __init__(self, stream: UniformSource, latent: Floats, persistence: Persistence) -> None:
        self._stream, self._latent, self._persistence = stream, latent, persistence
        self._shares = float(persistence.detection), float(persistence.range)

    def random(self, size: int | tuple[int, ...], /) -> Floats:
        """Return uniform random numbers of shape `size`."""
        new = self._stream.random(size)
        return persisting(new, self._latent, self._shares) if new.shape == self._latent.shape else new

    def parts(self) -> Iterator[tuple[slice, UniformSource]]:
        """Yield the columns of each copy and their source."""
        stream: Any = self._stream
        for rows, rng in stream.parts():
            yield rows, PersistentStream(rng, np.ascontiguousarray(self._latent[:, rows]), self._persistence)
