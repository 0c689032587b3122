"""Which law draws the readings of a model."""

from __future__ import annotations

from typing import Any

from noise.learned.networks import MlpModel
from noise.learned.recurrent import LstmModel
from noise.model import GaussianModel, IdealModel
from sonar_gym.sensing.laws.drawn import PathLaw
from sonar_gym.sensing.laws.general import GeneralLaw
from sonar_gym.sensing.laws.mixture import MAX_COMPONENTS
from sonar_gym.sensing.laws.normal import Normal
from sonar_gym.sensing.laws.perceptron import Perceptron
from sonar_gym.sensing.laws.recurrent import Recurrent


def compiled_law(model: Any, places: int, max_range: float) -> PathLaw | None:
    """Return the compiled form of a model for one set of sonars; None without one.

    Args:
        model: sonar model. A subclass may have another law, so only the classes themselves are compiled.
        places: number of places in a memory.
        max_range: range beyond which an echo is none, m.
    """
    kind = type(model)
    if kind in (IdealModel, GaussianModel):
        return Normal(model, max_range)
    if kind is MlpModel and model.head.components <= MAX_COMPONENTS:
        return Perceptron(model, max_range)
    if kind is LstmModel and model.head.components <= MAX_COMPONENTS:
        return Recurrent(model, places, max_range)
    return None


def path_law(model: Any, places: int, max_range: float) -> PathLaw:
    """Return the law of a model with a state of its own for this set of sonars, compiled where it has such a form."""
    return compiled_law(model, places, max_range) or GeneralLaw(model, places, max_range)
