"""Recordings in the form in which Esmi (2016) presented them to networks, and the results that the thesis printed.

Scaling (section 3.3, table 4.1): the four inputs are angle / 45 degrees, reflectance, reading / 6000 mm and credence;
the label is (distance - 30 mm) / 5970 mm. A ping without echo has reading 0. Credence is the share of a condition's
pings that read within 10 % of the true distance. It needs the true distance, so a robot could not compute it; the
input is retained because the thesis used it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from acquisition import Recording, SettingError
from acquisition.arrays import Bits, Floats, Ints, Singles
from noise.law import CREDENCE_TOLERANCE

Mask = Bits
FEATURES = ("angle", "reflectance", "reading", "credence")
MAX_ANGLE_RAD, MAX_READING_M = np.deg2rad(45.0), 6.0
MIN_DISTANCE_M, DISTANCE_SPAN_M = 0.030, 5.970
VALIDATION_SHARE = 10_000 / 133_100
MIN_PINGS = 100


@dataclass(frozen=True, eq=False)
class Samples:
    """Answered pings of a survey, rescaled.

    Attributes:
        feature: inputs in the order of `FEATURES`, (n, 4).
        label: rescaled true distance, (n,).
        condition: number of each ping's condition, counted from 0, (n,).
    """

    feature: Singles
    label: Singles
    condition: Ints

    @classmethod
    def of(cls, recording: Recording) -> Samples:
        """Rescale the answered pings of a recording; rows in which the sensor did not answer are omitted.

        Raises:
            SettingError: the recording has no reflectance, or fewer than `MIN_PINGS` answered pings.
        """
        if not recording.has("reflectance"):
            raise SettingError(
                f"{recording.name}: column reflectance is missing; it is an input of the thesis's networks"
            )
        answered = recording.reading.answered
        if answered.sum() < MIN_PINGS:
            raise SettingError(
                f"{recording.name}: {answered.sum()} pings were answered, training needs {MIN_PINGS}: record more"
            )
        ping, reading = recording.ping[answered], recording.reading[answered]
        condition = np.unique(recording.condition[answered], return_inverse=True)[1]
        measured = np.where(reading.echo, reading.range, 0.0)
        columns = [np.abs(ping.angle) / MAX_ANGLE_RAD, ping.reflectance, measured / MAX_READING_M]
        feature = np.stack([*columns, credence_of(measured, ping.distance, condition)[condition]], axis=1)
        label = (ping.distance - MIN_DISTANCE_M) / DISTANCE_SPAN_M
        return cls(feature.astype(np.float32), label.astype(np.float32), condition)

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.label)

    def __getitem__(self, rows: Ints) -> Samples:
        """Return selected pings."""
        return Samples(self.feature[rows], self.label[rows], self.condition[rows])

    @property
    def distance(self) -> Floats:
        """True distance, m, (n,)."""
        return metres(self.label)

    @property
    def reading(self) -> Floats:
        """Reading, m; 0 without echo, (n,)."""
        return self.feature[:, 2].astype(np.float64) * MAX_READING_M

    def split(self, rng: np.random.Generator, by_condition: bool = False) -> tuple[Samples, Samples]:
        """Shuffle and divide into training and validation pings: 123,100 and 10,000 of the thesis's 133,100.

        Args:
            rng: random generator of the order.
            by_condition: assign whole conditions. The thesis assigned single pings, so each condition is on both
                sides and its validation loss does not measure generalisation to new conditions.
        """
        order = rng.permutation(len(self))
        if by_condition:
            n_conditions = self.condition.max() + 1
            test = (rng.permutation(n_conditions) < round(VALIDATION_SHARE * n_conditions))[self.condition[order]]
            return self[order[~test]], self[order[test]]
        n_validation = round(VALIDATION_SHARE * len(self))
        return self[order[n_validation:]], self[order[:n_validation]]

    def loss_floor(self) -> float:
        """Return the least mean squared error that any function of the four inputs can have on these pings.

        Pings with equal inputs get the same output, at best the mean of their labels; the floor is the variance that
        remains.
        """
        group = np.unique(self.feature, axis=0, return_inverse=True)[1]
        label = self.label.astype(np.float64)
        mean = np.bincount(group, label) / np.bincount(group)
        return float(np.mean((label - mean[group]) ** 2))


def metres(label: NDArray[np.floating]) -> Floats:
    """Return the distance of a label or of a network's output, m.

    >>> metres(np.array([0.0, 0.6482])).round(3)
    array([0.03, 3.9 ])
    """
    return np.asarray(label, dtype=np.float64) * DISTANCE_SPAN_M + MIN_DISTANCE_M


def is_correct(estimate: Floats, distance: Floats) -> Mask:
    """Return which estimates lie within 10 % of the true distance, both in m."""
    return np.abs(estimate - distance) <= CREDENCE_TOLERANCE * distance * (1.0 + 1e-6)  # inputs have single precision


def credence_of(estimate: Floats, distance: Floats, condition: Ints) -> Floats:
    """Return the share of correct estimates in each condition, (n_conditions,).

    Args:
        estimate: readings, or outputs of a network, m, (n,).
        distance: true distance, m, (n,).
        condition: number of each ping's condition, (n,).
    """
    return np.bincount(condition, is_correct(estimate, distance)) / np.bincount(condition)


OptimiserName = Literal["sgd", "adagrad", "adadelta", "adam", "rmsprop", "nadam"]


@dataclass(frozen=True)
class Printed:
    """One row of a table: mean squared errors of rescaled distances after 15 online epochs, and the training time."""

    train: float
    validation: float
    minutes: float


# tables 4.2 (10 neurons), 4.3 (15), 4.4 (20)
TABLES: dict[int, dict[OptimiserName, Printed]] = {
    10: {
        "sgd": Printed(0.0390, 0.0376, 8.06),
        "adagrad": Printed(0.0456, 0.0439, 7.93),
        "adadelta": Printed(0.0305, 0.0265, 9.18),
        "adam": Printed(0.0206, 0.0160, 8.47),
        "rmsprop": Printed(0.0220, 0.0187, 8.08),
        "nadam": Printed(0.0198, 0.0157, 9.20),
    },
    15: {
        "sgd": Printed(0.0385, 0.0370, 7.92),
        "adagrad": Printed(0.0454, 0.0441, 7.97),
        "adadelta": Printed(0.0285, 0.0249, 8.98),
        "adam": Printed(0.0179, 0.0149, 8.64),
        "rmsprop": Printed(0.0221, 0.0173, 8.23),
        "nadam": Printed(0.0174, 0.0146, 9.33),
    },
    20: {
        "sgd": Printed(0.0393, 0.0382, 8.35),
        "adagrad": Printed(0.0458, 0.0442, 8.29),
        "adadelta": Printed(0.0283, 0.0252, 9.20),
        "adam": Printed(0.0177, 0.0147, 8.52),
        "rmsprop": Printed(0.0197, 0.0160, 7.96),
        "nadam": Printed(0.0169, 0.0144, 9.11),
    },
}
TABLE_NUMBER = {10: "4.2", 15: "4.3", 20: "4.4"}
# listing A.1 and figure A.1: 30 neurons, Nadam, 20 online epochs in 13.3 minutes
A1_TRAIN = (
    *(0.0326, 0.0203, 0.0178, 0.0167, 0.0161, 0.0159, 0.0157, 0.0155, 0.0154, 0.0154),
    *(0.0153, 0.0152, 0.0152, 0.0152, 0.0152, 0.0151, 0.0151, 0.0151, 0.0151, 0.0150),
)
A1_VALIDATION = (
    *(0.0207, 0.0168, 0.0152, 0.0150, 0.0141, 0.0142, 0.0137, 0.0144, 0.0137, 0.0141),
    *(0.0136, 0.0135, 0.0137, 0.0136, 0.0135, 0.0141, 0.0136, 0.0135, 0.0135, 0.0134),
)
A1_MINUTES = 13.3157
LSTM_TIME_RATIO = 5.0  # section 4.2: "almost 5 times longer than MLP model"
