"""What a training of the zoo logs to TensorBoard, read again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from acquisition.arrays import Floats

BOARD = "tensorboard"  # folder in that of a training
SUCCESS = "rollout/success_rate"


def success_rate(folder: Path) -> tuple[Floats, Floats]:
    """Return steps, and share of the last 100 episodes that ended parked, (k,) each.

    Args:
        folder: that `sonar-gym zoo` wrote.
    """
    (run,) = (folder / BOARD).iterdir()
    board = EventAccumulator(str(run), size_guidance={"scalars": 0})
    board.Reload()
    steps, rates = np.array([(one.step, one.value) for one in board.Scalars(SUCCESS)]).T
    return steps, rates
