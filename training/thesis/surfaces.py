"""Credence surfaces of readings and mapped readings, and mean distances of silent pings by angle and reflector.

Mapped readings are the distances that a network outputs. A network trained by squared error outputs the conditional
mean of the distance given its inputs. For a reading of 0 (no echo), an angle, a reflector and a credence this is the
mean distance of such silent pings: a sonar that detects nothing from distance d to the end of the grid at 6 m has the
mean (d + 6 m) / 2. The thesis's recordings were not published, so its networks are the only source of these means.
They contain neither the share of silent pings nor the scatter of readings, and small networks smooth them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from acquisition.survey.plan import THESIS_ANGLES
from training.thesis.data import (
    DISTANCE_SPAN_M,
    MAX_ANGLE_RAD,
    Floats,
    Mask,
    Samples,
    Singles,
    credence_of,
    is_correct,
    metres,
)
from training.thesis.networks import FlatNetwork

Predictor = Callable[[NDArray[np.floating]], NDArray[np.floating]]
"""Function from rescaled inputs (n, 4) to rescaled distances (n,)."""
MIRROR, RUBBER = "mirror", "rubber"
REFLECTORS = {MIRROR: 0.9, RUBBER: 0.1}
READINGS, SILENCE_AS_MEAN = "readings", "readings, silence replaced by its mean distance at that angle and reflector"
SHORT_RANGE_M = 0.5  # "close ranges (less than 500mm)", thesis section 4.1
ANGLES_DEG = np.array(THESIS_ANGLES)
MAX_DISTANCE_M = 6.0
HALF_WIDTH = 0.25  # tolerance of a credence of one half
KINDS = ("silent", "correct", "wrong")


@dataclass(frozen=True, eq=False)
class CredenceSurfaces:
    """Credence of each condition of a survey (thesis, figures 4.1 to 5.1).

    A network maps silence too, to about the mean distance of the silent pings at that angle and reflector, and is
    correct wherever the true distance happens to lie within 10 % of it. `SILENCE_AS_MEAN` does the same without a
    network and so separates what a network has learnt of readings from what it has learnt of silence.

    Attributes:
        samples: all pings.
        networks: architecture and one parameter vector per seed, by name.
    """

    samples: Samples
    networks: dict[str, tuple[FlatNetwork, list[Singles]]]

    @cached_property
    def credence(self) -> dict[str, Floats]:
        """Credence of each condition by name, (n_seeds, n_conditions); one row for readings."""
        reading = self.samples.reading
        estimates = {
            READINGS: [reading],
            SILENCE_AS_MEAN: [np.where(reading > 0, reading, self._silent_distance(reading == 0.0))],
            **{
                name: [metres(network.predict(theta, self.samples.feature)) for theta in weights]
                for name, (network, weights) in self.networks.items()
            },
        }
        distance, condition = self.samples.distance, self.samples.condition
        return {
            name: np.array([credence_of(one, distance, condition) for one in several])
            for name, several in estimates.items()
        }

    def _silent_distance(self, silent: Mask) -> Floats:
        """Return the mean distance of the silent pings at each ping's angle and reflector, m, (n,); 0 if none."""
        group = np.unique(self.samples.feature[:, :2], axis=0, return_inverse=True)[1]
        total, count = np.bincount(group, silent * self.samples.distance), np.bincount(group, silent)
        return (total / np.maximum(count, 1.0))[group]

    @cached_property
    def _first_row(self) -> NDArray[np.int64]:
        return np.unique(self.samples.condition, return_index=True)[1]

    @cached_property
    def distance(self) -> Floats:
        """Distance of each condition, m, (n_conditions,)."""
        return self.samples.distance[self._first_row]

    @cached_property
    def angle(self) -> Floats:
        """Angle of each condition, degrees, (n_conditions,)."""
        return 45.0 * self.samples.feature[self._first_row, 0].astype(np.float64)

    def of(self, reflector: str) -> Mask:
        """Return which conditions have a reflector, `MIRROR` or `RUBBER`, (n_conditions,)."""
        mirror = self.samples.feature[self._first_row, 1] > 0.5
        return mirror if reflector == MIRROR else ~mirror

    @cached_property
    def silent(self) -> Mask:
        """Conditions without any echo, (n_conditions,)."""
        return np.bincount(self.samples.condition, self.samples.feature[:, 2]) == 0.0

    def mean(self, name: str, conditions: Mask) -> Floats:
        """Return the mean credence over selected conditions, (n_seeds,); nan if there are none."""
        return self.credence[name][:, conditions].mean(axis=1) if conditions.any() else np.full(1, np.nan)


@dataclass(frozen=True, eq=False)
class SilentDistances:
    """Mean distances of silent pings, m, by reflector (`REFLECTORS`) and angle (`ANGLES_DEG`), (2, 11) each.

    Attributes:
        never: of conditions with credence 0: no reading was correct.
        half: of conditions with credence about 0.5, the edge of detection. Both are nan where there are none.
    """

    never: Floats
    half: Floats

    @classmethod
    def of_network(cls, network: Predictor) -> SilentDistances:
        """Evaluate a network at readings of 0."""
        return cls(_predicted(network, 0.0), _predicted(network, 0.5))

    @classmethod
    def of_samples(cls, samples: Samples) -> SilentDistances:
        """Average over pings."""
        credence = samples.feature[:, 3]
        return cls(_measured(samples, credence == 0.0), _measured(samples, np.abs(credence - 0.5) <= HALF_WIDTH))

    @classmethod
    def mean(cls, several: Sequence[SilentDistances]) -> SilentDistances:
        """Return the mean over networks."""
        return cls(np.mean([one.never for one in several], axis=0), np.mean([one.half for one in several], axis=0))

    def rms_difference(self, other: SilentDistances) -> float:
        """Return the root mean square difference in `never`, m; nan counts as 6 m."""
        difference = np.nan_to_num(self.never, nan=MAX_DISTANCE_M) - np.nan_to_num(other.never, nan=MAX_DISTANCE_M)
        return float(np.sqrt(np.mean(difference**2)))


def _predicted(network: Predictor, credence: float) -> Floats:
    angle, reflectance = np.meshgrid(np.deg2rad(ANGLES_DEG) / MAX_ANGLE_RAD, list(REFLECTORS.values()))
    columns = [angle, reflectance, np.zeros(angle.shape), np.full(angle.shape, credence)]
    inputs = np.stack(columns, axis=-1).reshape(-1, 4).astype(np.float32)
    return metres(network(inputs)).reshape(angle.shape)


def _measured(samples: Samples, selected: Mask) -> Floats:
    """Return the mean distance of the silent pings among selected ones, nan where there are none."""
    angle, reflectance, reading, _ = samples.feature.T
    column = np.abs(np.rad2deg(angle * MAX_ANGLE_RAD)[:, None] - ANGLES_DEG).argmin(axis=1)
    row = np.abs(reflectance[:, None] - list(REFLECTORS.values())).argmin(axis=1)
    group, shape = row * len(ANGLES_DEG) + column, (len(REFLECTORS), len(ANGLES_DEG))
    silent, n_groups = selected & (reading == 0.0), len(REFLECTORS) * len(ANGLES_DEG)
    total, count = np.bincount(group, silent * samples.distance, n_groups), np.bincount(group, silent, n_groups)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(shape)


def kinds(samples: Samples) -> dict[str, Mask]:
    """Return which pings are silent, have a correct reading, and have a wrong reading, by `KINDS`."""
    echo, correct = samples.reading > 0.0, is_correct(samples.reading, samples.distance)
    return dict(zip(KINDS, (~echo, echo & correct, echo & ~correct), strict=True))


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """Errors of a network on pings.

    Attributes:
        loss: mean squared error of rescaled distances, as in the thesis.
        by_kind: root mean square error for each of `KINDS`, m; nan where there are no pings.
    """

    loss: float
    by_kind: dict[str, float]

    @classmethod
    def of(cls, network: Predictor, samples: Samples) -> PredictionErrors:
        """Evaluate a network."""
        error = np.asarray(network(samples.feature), dtype=np.float64) - samples.label
        by_kind = {name: _rms_metres(error[rows]) for name, rows in kinds(samples).items()}
        return cls(float(np.mean(error**2)), by_kind)

    @classmethod
    def mean(cls, several: Sequence[PredictionErrors]) -> PredictionErrors:
        """Return the mean over networks."""
        by_kind = {name: float(np.mean([one.by_kind[name] for one in several])) for name in KINDS}
        return cls(float(np.mean([one.loss for one in several])), by_kind)


def _rms_metres(error: Floats) -> float:
    return DISTANCE_SPAN_M * float(np.sqrt(np.mean(error**2))) if len(error) else float("nan")


def mean_offsets(network: Predictor, samples: Samples, edges: Floats) -> Floats:
    """Return the mean error of a network on correct readings in bands of distance, m, (k,); positive is too far.

    Args:
        network: predictor.
        samples: pings.
        edges: limits of the bands, m, (k + 1,).
    """
    correct = samples[np.flatnonzero(kinds(samples)["correct"])]
    error = metres(np.asarray(network(correct.feature))) - correct.distance
    band = np.digitize(correct.distance, edges) - 1
    return np.array([error[band == k].mean() if (band == k).any() else np.nan for k in range(len(edges) - 1)])
