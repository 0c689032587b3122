"""A recording as the thesis fed it to its networks: four inputs rescaled to [0, 1], and the true distance as label.

Scaling as in Esmi (2016), section 3.3 and table 4.1: inputs are angle / 45 degrees, reflectance, reading / 6000 mm and
credence; the label is (distance - 30 mm) / 5970 mm. A ping without echo reads 0. Credence is that of the ping's whole
condition: the share of its pings that read within 10 % of the true distance. So the fourth input knows the truth;
a robot could not compute it. That is the thesis's design, kept here as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition import Recording, SettingError
from noise.law import CREDENCE_TOLERANCE

Singles = NDArray[np.float32]
Floats = NDArray[np.float64]
FEATURES = ("angle", "reflectance", "reading", "credence")
ANGLE_RAD, READING_M = np.deg2rad(45.0), 6.0
NEAREST_M, SPAN_M = 0.030, 5.970
VALIDATION_SHARE = 10_000 / 133_100
FEWEST_PINGS = 100


@dataclass(frozen=True, eq=False)
class Samples:
    """Answered pings of a survey.

    Attributes:
        feature: the four inputs, (n, 4).
        label: rescaled true distance, (n,).
        condition: number of each ping's condition, 0 to cells - 1, (n,).
    """

    feature: Singles
    label: Singles
    condition: NDArray[np.int64]

    @classmethod
    def of(cls, recording: Recording) -> Samples:
        """Rescale a recording; rows without an answer are left out, for a dead wire is no reading.

        Raises:
            SettingError: no reflectance was logged, or too little was answered to train on.
        """
        if not recording.has("reflectance"):
            raise SettingError(f"{recording.name}: column reflectance is missing, which the thesis's networks are told")
        answered = recording.reading.answered
        if answered.sum() < FEWEST_PINGS:
            raise SettingError(
                f"{recording.name}: {answered.sum()} pings were answered, training needs {FEWEST_PINGS}: record more"
            )
        ping, reading = recording.ping[answered], recording.reading[answered]
        cell = np.unique(recording.condition[answered], return_inverse=True)[1]
        heard = np.where(reading.echo, reading.range, 0.0)
        columns = [np.abs(ping.angle) / ANGLE_RAD, ping.reflectance, heard / READING_M]
        feature = np.stack([*columns, credence_of(heard, ping.distance, cell)[cell]], axis=1)
        return cls(feature.astype(np.float32), ((ping.distance - NEAREST_M) / SPAN_M).astype(np.float32), cell)

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.label)

    def __getitem__(self, rows: NDArray[np.int64]) -> Samples:
        """Return some pings."""
        return Samples(self.feature[rows], self.label[rows], self.condition[rows])

    @property
    def distance(self) -> Floats:
        """True distance, m, (n,)."""
        return metres(self.label)

    def split(self, rng: np.random.Generator, whole: bool = False) -> tuple[Samples, Samples]:
        """Shuffle, and deal single pings out to training and validation: 123,100 and 10,000 of the thesis's 133,100.

        Args:
            rng: of the order.
            whole: deal whole conditions out. The thesis dealt pings, so that every condition stood on both sides and
                its validation loss told nothing of new ones.
        """
        order = rng.permutation(len(self))
        validation = round(VALIDATION_SHARE * len(self))
        if whole:
            held = rng.permutation(self.condition.max() + 1) < round(VALIDATION_SHARE * (self.condition.max() + 1))
            return self[order[~held[self.condition[order]]]], self[order[held[self.condition[order]]]]
        return self[order[validation:]], self[order[:validation]]

    def floor(self) -> float:
        """Return the least squared error that any function of the four inputs can have on these pings.

        Pings with equal inputs get one answer, at best the mean of their labels; what is left is their variance.
        """
        group = np.unique(self.feature, axis=0, return_inverse=True)[1]
        label = self.label.astype(np.float64)
        mean = np.bincount(group, label) / np.bincount(group)
        return float(np.mean((label - mean[group]) ** 2))


def metres(label: NDArray[np.floating]) -> Floats:
    """Return the distance that a label or a network's output means, m.

    >>> metres(np.array([0.0, 0.6482])).round(3)
    array([0.03, 3.9 ])
    """
    return np.asarray(label, dtype=np.float64) * SPAN_M + NEAREST_M


def credence_of(said: Floats, distance: Floats, condition: NDArray[np.int64]) -> Floats:
    """Return the share of each condition's pings that lie within 10 % of the true distance, (cells,).

    Args:
        said: readings, or distances that a network maps them to, m, (n,).
        distance: true, m, (n,).
        condition: number of each ping's condition, (n,).
    """
    right = np.abs(said - distance) <= CREDENCE_TOLERANCE * distance * (1.0 + 1e-6)  # inputs are singles
    return np.bincount(condition, right) / np.bincount(condition)
