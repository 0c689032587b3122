"""The description of an LSTM in model.json."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition import ModelError
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.learned.networks import read_shape
from noise.learned.recurrent_state import N_ANCHORS, N_HISTORY_FEATURES
from noise.learned.tensors import shapes_of


@dataclass(frozen=True)
class LstmShape:
    """Inputs, head and layer widths of an LSTM, and head and layer widths of its base network, if any."""

    inputs: Inputs
    head: Head
    hidden: int
    sizes: list[int]
    base: tuple[Head, list[int]] | None

    @classmethod
    def read(cls, folder: Path, data: dict[str, Any]) -> LstmShape:
        """Parse and check the contents of model.json.

        Raises:
            ModelError: the contents do not describe an LSTM.
        """
        path = folder / "model.json"
        try:
            inputs, head = Inputs.from_dict(data["inputs"]), Head(**data["head"])
            hidden, sizes = int(data["hidden"]), [int(size) for size in data["sizes"]]
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ModelError(f"{path}: does not describe a network ({error}); train the model again") from None
        wanted = inputs.width + N_HISTORY_FEATURES + hidden
        if len(sizes) < 2 or sizes[0] != wanted or sizes[-1] != head.width or head.anchored != N_ANCHORS or hidden < 1:
            raise ModelError(
                f"{path}: layers {sizes} do not map {wanted} inputs to {head.width} outputs; train the model again"
            )
        given = data.get("base")
        base = None if given is None else read_shape(folder, {**given, "inputs": data["inputs"]})[1:]
        if base is not None and (base[0].near, base[0].fixed) != (head.near, head.fixed):
            raise ModelError(f"{path}: the base and the head differ in their components; train the model again")
        return cls(inputs, head, hidden, sizes, base)

    @property
    def tensors(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of all weights."""
        gates, width = 4 * self.hidden, self.inputs.width + N_HISTORY_FEATURES
        out = {"lstm.on_input": (gates, width), "lstm.on_hidden": (gates, self.hidden), "lstm.bias": (gates,)}
        out |= shapes_of(self.sizes)
        return out if self.base is None else out | shapes_of(self.base[1], "base.")
