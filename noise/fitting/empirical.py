"""Physical law with a smooth correction without a cause: the emulator of a simulator known only by its readings."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from acquisition import ModelError
from noise.effects import CATALOGUE, Atom, Effect, Parameter, Stage, State
from noise.effects.state import number
from noise.physical import PhysicalModel

DISTANCE_KNOTS = (0.1, 0.3, 0.7, 1.2, 2.0, 3.0, 4.5, 6.0)  # m, chosen here: denser where sonars change fastest
ANGLE_KNOTS = (0.0, 0.1, 0.25, 0.45, 0.8)  # rad
TILT_KNOTS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8)  # rad, chosen here: a ray cone of +-30 deg errs by 6 mm at 3 m
SOURCE = "smooth correction: chosen here"


def _knots(kind: str, unit: str, null: float, low: float, high: float) -> tuple[Parameter, ...]:
    near = [Parameter(f"{kind}_d{k}", unit, null, low, high, SOURCE) for k in range(len(DISTANCE_KNOTS))]
    return (*near, *_angles(kind, ANGLE_KNOTS, unit, null, low, high))


def _angles(
    kind: str, knots: tuple[float, ...], unit: str, null: float, low: float, high: float
) -> tuple[Parameter, ...]:
    return tuple(Parameter(f"{kind}_a{k}", unit, null, low, high, SOURCE) for k in range(1, len(knots)))


def interpolate(x: Tensor, knots: tuple[float, ...], values: list[Tensor]) -> Tensor:
    """Return the linear interpolation of (knots, values) at x, constant beyond the ends, (n,)."""
    place, height = number(list(knots)), torch.stack(values)
    x = torch.clamp(x, knots[0], knots[-1])
    left = torch.clamp(torch.searchsorted(place, x.contiguous(), right=True) - 1, 0, len(knots) - 2)
    share = (x - place[left]) / (place[left + 1] - place[left])
    return height[left] * (1.0 - share) + height[left + 1] * share


class Flexible(Effect):
    """Smooth corrections of bias, spread and P(no echo) over distance and angle: a description, never a cause.

    `tilt` is a share of the distance, piecewise linear in 1 - cos(incidence), like the nearest point of a tilted wall,
    which robot simulators find with a cone of rays.
    """

    name = "flexible"
    stage = Stage.SEQUENCE
    summary = "A smooth correction without a cause"
    parameters = (
        *_knots("bias", "m", 0.0, -0.4, 0.4),
        *_knots("spread", "m", 0.0, 0.0, 0.2),
        *_knots("silence", "1", 0.0, 0.0, 0.98),
        *_angles("tilt", TILT_KNOTS, "1", 0.0, -0.5, 0.5),
    )

    def _line(self, kind: str, state: State) -> Tensor:
        distance, angle = state.conditions.distance, torch.abs(state.conditions.angle)
        near = [getattr(self, f"{kind}_d{k}") for k in range(len(DISTANCE_KNOTS))]
        wide = self._wide(kind, ANGLE_KNOTS)
        return interpolate(distance, DISTANCE_KNOTS, near) + interpolate(angle, ANGLE_KNOTS, wide)

    def _wide(self, kind: str, knots: tuple[float, ...]) -> list[Tensor]:
        return [number(0.0), *(getattr(self, f"{kind}_a{k}") for k in range(1, len(knots)))]

    def _bias(self, state: State) -> Tensor:
        short = 1.0 - torch.cos(state.conditions.incidence)
        knots = tuple(1.0 - math.cos(angle) for angle in TILT_KNOTS)
        tilt = interpolate(short, knots, self._wide("tilt", TILT_KNOTS))
        return self._line("bias", state) + state.conditions.distance * tilt

    def apply(self, state: State) -> State:
        """Shift, widen and attenuate the direct path; the shift scales with the speed of sound."""
        path = state.direct
        stretched = path.length / torch.clamp(state.conditions.distance, min=1e-3)
        spread = torch.sqrt(path.spread**2 + self._line("spread", state) ** 2 + 1e-18) - 1e-9
        state = state.with_direct(replace(path, length=path.length + stretched * self._bias(state), spread=spread))
        weight = torch.clamp(self._line("silence", state), 0.0, 0.999)
        return state.with_atom(Atom(weight, torch.zeros_like, number(1.0), number(0.0)))


class EmpiricalModel(PhysicalModel):
    """A `PhysicalModel` with an optional `Flexible` part, saved as kind "empirical"."""

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data."""
        return {**super().to_dict(), "kind": "empirical"}

    @classmethod
    def from_dict(cls, data: dict[str, object]) -> EmpiricalModel:
        """Return the model that `to_dict` describes.

        Raises:
            ModelError: an effect is unknown or a value is invalid.
        """
        effects = data.get("effects", {})
        known: dict[str, type[Effect]] = {**CATALOGUE, Flexible.name: Flexible}
        if not isinstance(effects, dict) or any(name not in known for name in effects):
            raise ModelError(f"model: `effects` must map effect ids to parameters; known ids: {', '.join(known)}")
        stack = [known[name](**values) for name, values in effects.items()]
        return cls(stack, float(str(data["resolution"])), float(str(data["max_range"])))
