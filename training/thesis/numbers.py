"""What Esmi (2016) printed: tables 4.2 to 4.4 and listing A.1. Losses are squared errors of rescaled distances."""

from __future__ import annotations

from dataclasses import dataclass

from training.thesis.optimisers import OptimiserName


@dataclass(frozen=True)
class Printed:
    """One row of a table: losses after 15 online passes, and how long these took."""

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
LSTM_TIMES_AS_LONG = 5.0  # section 4.2: "almost 5 times longer than MLP model"
