"""The six optimisers that the thesis compares, with the settings they had in Keras 1.0.8.

All six are torch's own rules; only their settings differ from torch's defaults. The published networks' files state
Nadam's (learning rate 0.002, betas 0.9 and 0.999, epsilon 1e-8, schedule 0.004); the rest are Keras 1's defaults, which
are the values of the thesis's section 2.2.3. One difference is left, and it is invisible: Keras adds Adam's epsilon
before the correction of the second moment's bias, torch after it, so that at step t Keras has 1e-8 / sqrt(1 - 0.999^t)
where torch has 1e-8.

The thesis prints a momentum schedule 0.99 (1 - 0.5 * 0.96^(t / 250)); what it ran, by its files, has 0.9 for 0.99.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import torch

OptimiserName = Literal["sgd", "adagrad", "adadelta", "adam", "rmsprop", "nadam"]


@dataclass(frozen=True)
class Optimiser:
    """One rule.

    Attributes:
        title: as the thesis's tables write it.
        rule: torch's class.
        settings: its arguments, Keras 1's values under torch's names.
    """

    title: str
    rule: Callable[..., torch.optim.Optimizer]
    settings: dict[str, Any]

    def of(self, theta: torch.Tensor, learning_rate: float | None = None) -> torch.optim.Optimizer:
        """Return torch's optimiser of a vector of weights; a learning rate given replaces Keras's."""
        return self.rule([theta], **self.settings | ({} if learning_rate is None else {"lr": learning_rate}))


# in the order of the thesis's tables 4.2 to 4.4
OPTIMISERS: dict[OptimiserName, Optimiser] = {
    "sgd": Optimiser("SGD", torch.optim.SGD, {"lr": 0.01}),
    "adagrad": Optimiser("ADAGRAD", torch.optim.Adagrad, {"lr": 0.01, "eps": 1e-8}),
    "adadelta": Optimiser("ADADELTA", torch.optim.Adadelta, {"lr": 1.0, "rho": 0.95, "eps": 1e-8}),
    "adam": Optimiser("ADAM", torch.optim.Adam, {"lr": 0.001, "betas": (0.9, 0.999), "eps": 1e-8}),
    "rmsprop": Optimiser("RMSProp", torch.optim.RMSprop, {"lr": 0.001, "alpha": 0.9, "eps": 1e-8}),
    "nadam": Optimiser(
        "NADAM", torch.optim.NAdam, {"lr": 0.002, "betas": (0.9, 0.999), "eps": 1e-8, "momentum_decay": 0.004}
    ),
}
assert tuple(OPTIMISERS) == get_args(OptimiserName)
