"""EmpiricalModel: a physical law with smooth corrections and the scatter of placements, as a model of single pings."""

from __future__ import annotations

from torch import Tensor

from acquisition import ModelError
from noise.effects import CATALOGUE, Effect, Parameter, Stage, State
from noise.fitting.smooth import Smooth, term_of
from noise.fitting.visit_effects import widened
from noise.physical import PhysicalModel


class PlacementScatter(Effect):
    """Targets are placed with errors of distance and of level, which single readings show as scatter."""

    name = "placement_scatter"
    stage = Stage.SEQUENCE
    summary = "Targets are placed with an error"
    parameters = (
        Parameter("sigma_m", "m", 0.0, 0.0, 0.3, "ruler and mount, 1 to 5 mm; wider: chosen here"),
        Parameter("level_sd_db", "dB", 0.0, 0.0, 15.0, "turn of the target and air of a visit; chosen here"),
    )
    sigma_m: Tensor
    level_sd_db: Tensor

    def apply(self, state: State) -> State:
        """Widen the direct path and its threshold."""
        return widened(state, self.sigma_m**2, self.level_sd_db**2)


class EmpiricalModel(PhysicalModel):
    """A `PhysicalModel` with `Smooth` corrections and the scatter of placements, saved as kind "empirical"."""

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data."""
        terms = [effect for effect in self.effects if isinstance(effect, Smooth)]
        effects = {effect.name: effect.values for effect in self.effects if not isinstance(effect, Smooth)}
        base = {"kind": "empirical", "resolution": self.resolution, "max_range": self.max_range}
        return {**base, "effects": effects, "terms": [term.to_dict() for term in terms]}

    @classmethod
    def from_dict(cls, data: dict[str, object]) -> EmpiricalModel:
        """Return the model that `to_dict` describes.

        Raises:
            ModelError: an effect is unknown or a value is invalid.
        """
        effects, terms = data.get("effects", {}), data.get("terms", [])
        known: dict[str, type[Effect]] = {**CATALOGUE, PlacementScatter.name: PlacementScatter}
        if not isinstance(effects, dict) or any(name not in known for name in effects):
            raise ModelError(f"model: `effects` must map effect ids to parameters; known ids: {', '.join(known)}")
        if not isinstance(terms, list) or not all(isinstance(term, dict) for term in terms):
            raise ModelError("model: `terms` must be a list of smooth terms")
        stack = [known[name](**values) for name, values in effects.items()]
        try:
            limits = float(str(data["resolution"])), float(str(data["max_range"]))
        except (KeyError, ValueError) as error:
            raise ModelError(f"model: cannot be built from its parameters ({error}); it may be damaged") from None
        return cls([*stack, *map(term_of, terms)], *limits)
