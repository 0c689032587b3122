"""Training data in the form of the thesis, and the results that the thesis prints.

Scaling as in Esmi (2016), section 3.3 and table 4.1. The inputs are angle / 45 degrees, reflectance, reading / 6000 mm
and credence; the label is (distance - 30 mm) / 5970 mm. A ping without echo has reading 0. Credence is the fraction of
the pings of the same condition with a reading within 10 % of the true distance. It depends on the true distance, so a
robot cannot compute it; the thesis uses it as an input all the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from acquisition import Recording, SettingError
from acquisition.arrays import Bits, Floats, Ints, Singles
from noise.law import CREDENCE_TOLERANCE

FEATURES = ("angle", "reflectance", "reading", "credence")
MAX_ANGLE_DEG, MAX_RANGE = 45.0, 6.0
MIN_DISTANCE, DISTANCE_SPAN = 0.030, 5.970  # m
VALIDATION_SHARE = 10_000 / 133_100
MIN_PINGS = 100


@dataclass(frozen=True, eq=False)
class Samples:
    """Answered pings of a survey.

    Attributes:
        feature: the four inputs, (n, 4).
        label: rescaled true distance, (n,).
        condition: index of each ping's condition, 0 to conditions - 1, (n,).
    """

    feature: Singles
    label: Singles
    condition: Ints

    @classmethod
    def of(cls, recording: Recording) -> Samples:
        """Rescale the answered pings of a recording.

        Raises:
            SettingError: the recording has no reflectance or too few answered pings.
        """
        if not recording.has("reflectance"):
            raise SettingError(f"{recording.name}: column reflectance is missing; it is an input of the networks")
        answered = recording.reading.answered
        if answered.sum() < MIN_PINGS:
            raise SettingError(
                f"{recording.name}: {answered.sum()} answered pings, training needs at least {MIN_PINGS}: record more"
            )
        ping, reading = recording.ping[answered], recording.reading[answered]
        condition = np.unique(recording.condition[answered], return_inverse=True)[1]
        measured = np.where(reading.echo, reading.range, 0.0)
        credence = credence_of(measured, ping.distance, condition)[condition]
        columns = [np.abs(ping.angle) / np.deg2rad(MAX_ANGLE_DEG), ping.reflectance, measured / MAX_RANGE, credence]
        label = (ping.distance - MIN_DISTANCE) / DISTANCE_SPAN
        return cls(np.stack(columns, axis=1).astype(np.float32), label.astype(np.float32), condition)

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.label)

    def __getitem__(self, rows: Ints) -> Samples:
        """Return the pings of some rows."""
        return Samples(self.feature[rows], self.label[rows], self.condition[rows])

    @property
    def distance(self) -> Floats:
        """True distance, m, (n,)."""
        return metres(self.label)

    @property
    def angle_deg(self) -> Floats:
        """Absolute angle, degrees, (n,)."""
        return MAX_ANGLE_DEG * self.feature[:, 0].astype(np.float64)

    @property
    def range(self) -> Floats:
        """Reading, m, 0 without echo, (n,)."""
        return self.feature[:, 2].astype(np.float64) * MAX_RANGE

    def split(self, rng: np.random.Generator, by_condition: bool = False) -> tuple[Samples, Samples]:
        """Return shuffled training and validation pings: 123,100 and 10,000 of the thesis's 133,100.

        Args:
            rng: random generator of the order.
            by_condition: put all pings of a condition on one side. The thesis assigns single pings, so both sides
                contain every condition and the validation loss does not measure the error on new conditions.
        """
        order = rng.permutation(len(self))
        n_validation = round(VALIDATION_SHARE * len(self))
        if by_condition:
            n = self.condition.max() + 1
            chosen = (rng.permutation(n) < round(VALIDATION_SHARE * n))[self.condition[order]]
            return self[order[~chosen]], self[order[chosen]]
        return self[order[n_validation:]], self[order[:n_validation]]

    def loss_floor(self) -> float:
        """Return the minimum mean squared error of any function of the four inputs on these pings.

        The best output for pings with equal inputs is the mean of their labels; the floor is the remaining variance.
        """
        group = np.unique(self.feature, axis=0, return_inverse=True)[1]
        label = self.label.astype(np.float64)
        return float(np.mean((label - group_mean(label, group, group.max() + 1)[group]) ** 2))


def metres(label: NDArray[np.floating]) -> Floats:
    """Return the distance of a label or a network output, m.

    >>> metres(np.array([0.0, 0.6482])).round(3)
    array([0.03, 3.9 ])
    """
    return np.asarray(label, dtype=np.float64) * DISTANCE_SPAN + MIN_DISTANCE


def is_right(estimate: Floats, distance: Floats) -> Bits:
    """Return which estimates, m, lie within 10 % of the true distance, m, (n,)."""
    return np.abs(estimate - distance) <= CREDENCE_TOLERANCE * distance * (1.0 + 1e-6)  # single-precision inputs


def credence_of(estimate: Floats, distance: Floats, condition: Ints) -> Floats:
    """Return the credence of each condition, (conditions,).

    Args:
        estimate: readings or network outputs, m, (n,).
        distance: true distance, m, (n,).
        condition: index of each ping's condition, (n,).
    """
    return group_mean(is_right(estimate, distance), condition, condition.max() + 1)


def group_mean(value: Floats | Bits, group: Ints, groups: int) -> Floats:
    """Return the mean value of each group, nan for an empty group, (groups,)."""
    total, count = np.bincount(group, value, groups), np.bincount(group, minlength=groups)
    return np.divide(total, count, out=np.full(groups, np.nan), where=count > 0)


OptimiserName = Literal["sgd", "adagrad", "adadelta", "adam", "rmsprop", "nadam"]


@dataclass(frozen=True)
class PrintedResult:
    """One row of tables 4.2 to 4.4.

    Attributes:
        train: training loss after 15 online passes (mean squared error of rescaled distances).
        validation: validation loss after 15 online passes.
        minutes: training time.
    """

    train: float
    validation: float
    minutes: float


# tables 4.2 (10 neurons), 4.3 (15), 4.4 (20)
TABLES: dict[int, dict[OptimiserName, PrintedResult]] = {
    10: {
        "sgd": PrintedResult(0.0390, 0.0376, 8.06),
        "adagrad": PrintedResult(0.0456, 0.0439, 7.93),
        "adadelta": PrintedResult(0.0305, 0.0265, 9.18),
        "adam": PrintedResult(0.0206, 0.0160, 8.47),
        "rmsprop": PrintedResult(0.0220, 0.0187, 8.08),
        "nadam": PrintedResult(0.0198, 0.0157, 9.20),
    },
    15: {
        "sgd": PrintedResult(0.0385, 0.0370, 7.92),
        "adagrad": PrintedResult(0.0454, 0.0441, 7.97),
        "adadelta": PrintedResult(0.0285, 0.0249, 8.98),
        "adam": PrintedResult(0.0179, 0.0149, 8.64),
        "rmsprop": PrintedResult(0.0221, 0.0173, 8.23),
        "nadam": PrintedResult(0.0174, 0.0146, 9.33),
    },
    20: {
        "sgd": PrintedResult(0.0393, 0.0382, 8.35),
        "adagrad": PrintedResult(0.0458, 0.0442, 8.29),
        "adadelta": PrintedResult(0.0283, 0.0252, 9.20),
        "adam": PrintedResult(0.0177, 0.0147, 8.52),
        "rmsprop": PrintedResult(0.0197, 0.0160, 7.96),
        "nadam": PrintedResult(0.0169, 0.0144, 9.11),
    },
}
TABLE_NUMBER = {10: "4.2", 15: "4.3", 20: "4.4"}
# listing A.1 and figure A.1: 30 neurons, Nadam, 20 online passes in 13.3 minutes
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
# table 4.1, mirror at 30 degrees and 3900 mm: condition, credence and readings
PRINTED_CONDITION = {"angle_deg": 30.0, "reflectance": 0.9, "distance_m": 3.9}
PRINTED_CREDENCE, PRINTED_READINGS_MM = "0.88", "3950 to 3970"
