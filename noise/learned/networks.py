"""A learned law without memory: a perceptron from conditions to a mixture, evaluated by numpy.

Outside the learned conditions the network is evaluated at the nearest learned one, and its law is widened and mixed
with a uniform law; `MixtureLaw.extrapolates` and `excess` report it. With a missing covariate the law is that over all
of its values; `MixtureLaw.missing` reports it.
"""

from __future__ import annotations

import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any
from weakref import WeakSet

import numpy as np

from acquisition import ModelError, Ping, Reading, SettingError
from acquisition.arguments import checked
from acquisition.arrays import Floats
from acquisition.limits import near
from noise.law import ExtrapolationWarning
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head, MixtureLaw
from noise.learned.persistence import Persistence
from noise.learned.tensors import Layers, as_layers, layers_of, read_tensors, shapes_of, tensors_of, write_tensors

# models that have warned of what they were not trained with, and of what they do not know; not attributes, since they
# are no part of the law
WARNED: WeakSet[Any] = WeakSet()
WARNED_UNKNOWN: WeakSet[Any] = WeakSet()


def dense(layers: Layers, x: Floats) -> Floats:
    """Return the outputs of dense layers for inputs (n, in), with tanh between the layers and none after the last."""
    for weight, bias in layers[:-1]:
        x = np.tanh(x @ weight.T + bias)
    weight, bias = layers[-1]
    return x @ weight.T + bias


def of_distance(model: Any, law: MixtureLaw, ping: Ping, known: Ping) -> MixtureLaw:
    """Return the law with the true distances of pings, and warn once per model where it extrapolates or ignores.

    Args:
        model: with `inputs`.
        law: of the equivalent pings.
        ping: conditions, (n,).
        known: equivalent pings, see `Inputs.equivalent`.
    """
    law.distance = ping.distance
    if model not in WARNED and law.outside.any():
        WARNED.add(model)
        limits = "; ".join(model.inputs.stated_outside(known))
        warnings.warn(f"the law extrapolates: it was trained with {limits} (law.extrapolates)", ExtrapolationWarning, 3)
    unknown = ping.covariates.keys() - model.inputs.known
    if unknown and model not in WARNED_UNKNOWN:
        WARNED_UNKNOWN.add(model)
        first = min(unknown)
        hint = near(first, model.inputs.known)
        text = f"the law does not know {', '.join(sorted(unknown))}, and ignores it{hint}"
        warnings.warn(text, ExtrapolationWarning, 3)
    return law


class MlpModel:
    """A multilayer perceptron from a ping's conditions to its law.

    Args:
        inputs: features of a condition.
        head: interpretation of the outputs as a law.
        layers: weights (out, in) and biases (out,) of each layer; tanh between them.
        about: plain data on the training, stored in model.json.
        card: text of the folder's README.md.
        persistence: the part of the law's spread that persists from ping to ping; None if unknown.
    """

    remembers = False

    @checked
    def __init__(
        self,
        inputs: Inputs,
        head: Head,
        layers: Layers,
        about: dict[str, object] | None = None,
        card: str = "",
        persistence: Persistence | None = None,
    ) -> None:
        self.inputs, self.head, self.about, self.card = inputs, head, about or {}, card
        self.persistence = persistence
        self.layers = as_layers("MlpModel.layers", layers)

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.head.resolution

    @checked
    def law(self, ping: Ping, past: Reading | None = None) -> MixtureLaw:
        """Return the law of n pings; the past is ignored."""
        known = self.inputs.equivalent(ping)
        batch = self.inputs.features(known)
        return of_distance(self, self.head.law(dense(self.layers, batch.feature), batch), ping, known)

    @property
    def sizes(self) -> list[int]:
        """Widths of all layers, the input first."""
        return [self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers)]

    def to_dict(self) -> dict[str, object]:
        """Return everything but the weights as plain data."""
        return {
            "kind": "mlp",
            "sizes": self.sizes,
            "inputs": self.inputs.to_dict(),
            "head": asdict(self.head),
            "persistence": None if self.persistence is None else self.persistence.to_dict(),
            "about": self.about,
        }

    @checked
    def write_weights(self, folder: Path) -> None:
        """Write the weights, and the card if there is one, into a folder."""
        write_tensors(folder, tensors_of(self.layers), self.card)

    @classmethod
    @checked
    def load(cls, folder: Path, data: dict[str, object]) -> MlpModel:
        """Load a saved network.

        Args:
            folder: folder with the weights.
            data: contents of model.json.

        Raises:
            ModelError: model.json or the weights are damaged or do not match.
        """
        inputs, head, sizes = read_shape(folder, data)
        tensors, text = read_tensors(folder, shapes_of(sizes))
        persistence = read_persistence(folder, data)
        return cls(inputs, head, layers_of(tensors, len(sizes) - 1), read_about(data), text, persistence)


def read_about(data: dict[str, Any]) -> dict[str, object]:
    """Return the free part of model.json, which describes the training."""
    return data.get("about", {})


def read_persistence(folder: Path, data: dict[str, Any]) -> Persistence | None:
    """Return the persisting part of the spread from model.json; None if it has none.

    Raises:
        ModelError: a value is missing, not a number, or outside its limits.
    """
    try:
        return Persistence.from_dict(data.get("persistence"))
    except (TypeError, ValueError, AttributeError, SettingError) as error:
        raise ModelError(f"{folder / 'model.json'}: persistence is invalid ({error}); train the model again") from None


def read_shape(folder: Path, data: dict[str, Any]) -> tuple[Inputs, Head, list[int]]:
    """Return inputs, head and layer widths of a perceptron from model.json.

    Raises:
        ModelError: the contents do not describe a perceptron.
    """
    path = folder / "model.json"
    try:
        inputs = Inputs.from_dict(data["inputs"])
        head, sizes = Head(**data["head"]), [int(size) for size in data["sizes"]]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ModelError(f"{path}: does not describe a network ({error}); train the model again") from None
    if len(sizes) < 2 or sizes[0] != inputs.width or sizes[-1] != head.width or min(sizes) < 1:
        raise ModelError(
            f"{path}: layers {sizes} do not map {inputs.width} inputs to {head.width} outputs; train the model again"
        )
    return inputs, head, sizes
