"""Where a sonar went silent: according to networks that were trained on its pings, and according to pings themselves.

A network trained by squared error answers with the mean distance at which its inputs were met. Told that nothing was
heard, at an angle, with a reflector and a credence, it so gives the mean distance of such silent pings: a sonar that is
deaf from some distance to the end of the grid at 6 m went deaf at twice that mean less 6 m. This is all that is left of
the thesis's recordings, which were not published. It does not say how often the sonar was silent, nor how its readings
scattered, and small networks blur what they learnt; how much, networks of the same shape show that were trained on
pings which are at hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.survey.plan import THESIS_ANGLES
from noise.law import CREDENCE_TOLERANCE
from training.thesis.data import ANGLE_RAD, SPAN_M, Floats, Samples, metres

Answer = Callable[[NDArray[np.floating]], NDArray[np.floating]]
"""From the four rescaled inputs (n, 4) to labels, (n,)."""
ANGLES_DEG = np.array(THESIS_ANGLES)
REFLECTORS = {"mirror": 0.9, "rubber": 0.1}
FARTHEST_M = 6.0
NEVER, HALF = 0.0, 0.5  # credences asked about: never read right, and right in every other ping
WIDTH = 0.25  # to each side of a half


@dataclass(frozen=True, eq=False)
class Silence:
    """Mean distances of silent pings, m, by reflector (`REFLECTORS`) and angle (`ANGLES_DEG`), (2, 11) each.

    Attributes:
        never: where the sonar never read right.
        half: where it did about half of the time: the edge of what it hears. nan where there is no such place.
    """

    never: Floats
    half: Floats

    @classmethod
    def of_network(cls, network: Answer) -> Silence:
        """Ask a network."""
        return cls(_asked(network, NEVER), _asked(network, HALF))

    @classmethod
    def of_samples(cls, samples: Samples) -> Silence:
        """Average over pings themselves."""
        credence = samples.feature[:, 3]
        return cls(_mean(samples, credence == NEVER), _mean(samples, np.abs(credence - HALF) <= WIDTH))

    @property
    def deaf_from(self) -> Floats:
        """Distance from which it hears nothing, if it hears nothing from there to the end of the grid, m, (2, 11)."""
        return np.clip(2.0 * np.nan_to_num(self.never, nan=FARTHEST_M) - FARTHEST_M, 0.0, FARTHEST_M)

    def apart(self, other: Silence) -> float:
        """Return the root mean square of the differences in `never`, m; nowhere silent counts as silent from 6 m."""
        mine, its = (np.nan_to_num(one.never, nan=FARTHEST_M) for one in (self, other))
        return float(np.sqrt(np.mean((mine - its) ** 2)))


def middle(silences: list[Silence]) -> Silence:
    """Return the mean of what several networks answer."""
    never, half = (np.mean([getattr(one, name) for one in silences], axis=0) for name in ("never", "half"))
    return Silence(never, half)


def _asked(network: Answer, credence: float) -> Floats:
    angle, reflectance = np.meshgrid(np.deg2rad(ANGLES_DEG) / ANGLE_RAD, list(REFLECTORS.values()))
    columns = [angle, reflectance, np.zeros(angle.shape), np.full(angle.shape, credence)]
    inputs = np.stack(columns, axis=-1).reshape(-1, 4).astype(np.float32)
    return metres(network(inputs)).reshape(angle.shape)


def _mean(samples: Samples, which: NDArray[np.bool_]) -> Floats:
    """Return the mean distance of the silent pings among some, nan where there are none."""
    angle, reflectance, reading, _ = samples.feature.T
    column = np.abs(np.rad2deg(angle * ANGLE_RAD)[:, None] - ANGLES_DEG).argmin(axis=1)
    row = np.abs(reflectance[:, None] - list(REFLECTORS.values())).argmin(axis=1)
    place, shape = row * len(ANGLES_DEG) + column, (len(REFLECTORS), len(ANGLES_DEG))
    here = which & (reading == 0.0)
    total, count = np.bincount(place, here * samples.distance, np.prod(shape)), np.bincount(place, here, np.prod(shape))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(shape)


KINDS = ("silent", "right", "wrong")


def kinds(samples: Samples) -> dict[str, NDArray[np.bool_]]:
    """Tell which pings were silent, which read right, and which wrong."""
    heard = samples.feature[:, 2].astype(np.float64) * FARTHEST_M
    right = np.abs(heard - samples.distance) <= CREDENCE_TOLERANCE * samples.distance * (1.0 + 1e-6)
    return dict(zip(KINDS, (heard == 0.0, right & (heard > 0.0), ~right & (heard > 0.0)), strict=True))


@dataclass(frozen=True, eq=False)
class Errors:
    """How a network fares on pings.

    Attributes:
        loss: mean squared error of rescaled distances, as the thesis has it.
        by_kind: root mean square error on each of `KINDS`, m; nan where there are none.
    """

    loss: float
    by_kind: dict[str, float]

    @classmethod
    def of(cls, network: Answer, samples: Samples) -> Errors:
        """Work out from a network's answers."""
        error = np.asarray(network(samples.feature), dtype=np.float64) - samples.label
        by_kind = {name: _root(error[which]) for name, which in kinds(samples).items()}
        return cls(float(np.mean(error**2)), by_kind)

    @classmethod
    def mean(cls, errors: Sequence[Errors]) -> Errors:
        """Return the means over networks."""
        by_kind = {name: float(np.mean([one.by_kind[name] for one in errors])) for name in KINDS}
        return cls(float(np.mean([one.loss for one in errors])), by_kind)


def _root(error: Floats) -> float:
    return SPAN_M * float(np.sqrt(np.mean(error**2))) if len(error) else float("nan")


def offset(network: Answer, samples: Samples, edges: Floats) -> Floats:
    """Return by how much a network puts right readings farther than they were, on average over bands of distance, m.

    Args:
        network: any.
        samples: pings.
        edges: of the bands, m, (k + 1,).
    """
    right = kinds(samples)["right"]
    error = metres(np.asarray(network(samples.feature[right]))) - samples.distance[right]
    band = np.digitize(samples.distance[right], edges) - 1
    return np.array([error[band == k].mean() if (band == k).any() else np.nan for k in range(len(edges) - 1)])
