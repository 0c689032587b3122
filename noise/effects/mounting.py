"""Mounting effects: geometry of the sensor, its beam and the turntable."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.special import j0, j1
from torch import Tensor

from noise.effects.base import Effect, Parameter, Stage
from noise.effects.state import Path, State

HALF_AMPLITUDE = 2.215  # x at which 2 J1(x) / x = 1/2, the edge of a quoted -6 dB beam
LEAK = 0.01  # amplitude of leakage by housing and side lobes at any bearing; chosen here
EDGE_DB_PER_RAD = math.degrees(
    20.0
)  # loss beyond the edge of a field of view, which is sharp; finite for its derivative
LEAST_COSINE = 0.05  # of a ray to the perpendicular of a face; beyond 87 deg a path has no end
SMALL = 1e-2  # x below which three terms of the power series are exact to 1e-14


class _Directivity(torch.autograd.Function):
    """2 J1(x) / x and its derivative, 2 (J0(x) - 2 J1(x) / x) / x; torch's own Bessel functions err by 4e-7."""

    @staticmethod
    def forward(x: Tensor) -> Tensor:
        near = 1.0 - x**2 / 8.0 + x**4 / 192.0
        return torch.where(x.abs() < SMALL, near, 2.0 * torch.from_numpy(np.asarray(j1(x.numpy()))) / x)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor], output: Tensor) -> None:
        ctx.save_for_backward(inputs[0], output)

    @staticmethod
    def backward(ctx: Any, slope: Tensor) -> Tensor:
        x, value = ctx.saved_tensors
        far = 2.0 * (torch.from_numpy(np.asarray(j0(x.numpy()))) - value) / x
        return slope * torch.where(x.abs() < SMALL, -x / 4.0 + x**3 / 48.0, far)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None], x: Tensor) -> tuple[Tensor, int | None]:
        return _Directivity.apply(x), in_dims[0]


def directivity(x: Tensor) -> Tensor:
    """Return the amplitude of a piston off its axis, 2 J1(x) / x, differentiable once."""
    return _Directivity.apply(x)


class BeamWidth(Effect):
    """Two-way directivity of a piston: level -> level + 40 log10 D(ka sin(bearing)), D(x) = 2 J1(x) / x."""

    name = "beam_width"
    stage = Stage.MEDIUM
    summary = "The beam is narrower than assumed: echoes from the side are weaker"
    parameters = (
        Parameter("ka", "1", 0.0, 0.0, 16.0, "piston; 4.8: Devantech's 55 deg at -6 dB; 15: 17 deg", (3.0, 4.8, 9.0)),
    )
    ka: Tensor

    def apply(self, state: State) -> State:
        """Attenuate every path by its bearing; `LEAK` fills the nulls of an ideal piston."""
        return state.map_paths(self._point)

    def _point(self, path: Path) -> Path:
        amplitude = directivity(self.ka * torch.sin(torch.clamp(path.bearing.abs(), max=math.pi / 2)))
        loss_db = 20.0 * torch.log10((amplitude**2 + LEAK**2) / (1.0 + LEAK**2))
        return replace(path, level_db=path.level_db + loss_db)

    def statement(self) -> str:
        """Return a sentence with the full -6 dB angle."""
        ka = self.values["ka"]
        if ka <= HALF_AMPLITUDE:
            return f"{self.summary} (ka {ka:.2g}: no -6 dB edge within 90 deg)."
        width = 2 * math.degrees(math.asin(HALF_AMPLITUDE / ka))
        return f"The beam has a full width of {width:.0f} deg at -6 dB: echoes from the side are weaker."


class Boresight(Effect):
    """The beam axis deviates by `yaw_deg` from the reference of bearings; observable only with a finite beam width."""

    name = "boresight"
    stage = Stage.CONDITION
    summary = "The beam axis deviates from the reference axis of angles"
    parameters = (
        Parameter(
            "yaw_deg", "deg", 0.0, -30.0, 30.0, "0 to 3 deg; wider: chosen here", (-3.0, 3.0), typical=3.0, adds=True
        ),
    )
    yaw_deg: Tensor

    def apply(self, state: State) -> State:
        """Rotate the bearings."""
        turned = state.conditions.angle - torch.deg2rad(self.yaw_deg)
        return state.facing(replace(state.conditions, angle=turned))

    def statement(self) -> str:
        """Return a sentence with the angle and its sign."""
        return f"The beam axis deviates by {self.values['yaw_deg']:+.1f} deg from the reference axis of angles."


class PivotOffset(Effect):
    """The reflector rotates about an axis off its face, e behind and f beside: d -> d + e (1 - cos t) + f sin t."""

    name = "pivot_offset"
    stage = Stage.CONDITION
    summary = "The rotation axis is off the reflector's face: the distance changes with the rotation"
    parameters = (
        Parameter(
            "axial_m",
            "m",
            0.0,
            -0.35,
            0.35,
            "thesis stand 0 to 320 mm behind the face",
            (0.1, -0.1),
            typical=0.1,
            adds=True,
        ),
        Parameter("lateral_m", "m", 0.0, -0.35, 0.35, "as axial_m; chosen here", (0.0,), typical=0.05, adds=True),
    )
    axial_m: Tensor
    lateral_m: Tensor

    def apply(self, state: State) -> State:
        """Shift the reflector according to its rotation."""
        turn = state.conditions.incidence
        moved = state.conditions.distance + self.axial_m * (1.0 - torch.cos(turn)) + self.lateral_m * torch.sin(turn)
        return state.facing(replace(state.conditions, distance=torch.clamp(moved, min=0.0)))

    def statement(self) -> str:
        """Return a sentence with the shift at 45 degrees."""
        shift = self.values["axial_m"] * (1 - math.cos(math.pi / 4)) + self.values["lateral_m"] * math.sin(math.pi / 4)
        return (
            f"The rotation axis is off the reflector's face: the distance changes by {1000 * shift:+.0f} mm at 45 deg."
        )


class BaselineParallax(Effect):
    """Transmitter and receiver are separate: half the path length is sqrt(d^2 + (spacing/2)^2)."""

    name = "baseline_parallax"
    stage = Stage.PATHS
    summary = "Transmitter and receiver are separate: near readings are too long"
    parameters = (
        Parameter("spacing_m", "m", 0.0, 0.0, 0.2, "SRF08: 25 mm; wider: chosen here", (0.03, 0.1), typical=0.03),
    )
    spacing_m: Tensor

    def apply(self, state: State) -> State:
        """Lengthen every path by the geometry of the spacing."""
        return state.map_paths(self._slant)

    def _slant(self, path: Path) -> Path:
        near = torch.clamp(path.length, min=1e-3)  # sqrt has no derivative at 0
        return replace(path, length=path.length + torch.sqrt(near**2 + (self.spacing_m / 2.0) ** 2) - near)

    def statement(self) -> str:
        """Return a sentence with the spacing and the error at 100 mm."""
        spacing = self.values["spacing_m"]
        error = math.hypot(0.1, spacing / 2) - 0.1
        apart = f"Transmitter and receiver are {1000 * spacing:.0f} mm apart"
        return f"{apart}: near readings are too long, by {1000 * error:.1f} mm at 100 mm."


class RayCone(Effect):
    """A simulator casts rays over its field of view and returns the shortest that meets a flat face.

    The ray is that nearest to the perpendicular, at bearing psi = beta - theta, within the field of view and the face:
    s = d cos(theta) / cos(bearing - psi). No ray, or one that meets the face too obliquely, is no echo.
    """

    name = "ray_cone"
    stage = Stage.PATHS
    of_simulators = True
    summary = "Rays over a field of view are read as the shortest that meets the face"
    parameters = (
        Parameter("half_deg", "deg", 180.0, 2.0, 180.0, "half the field of view; chosen here", (12.0, 25.0)),
        Parameter("half_width_m", "m", 0.0, 0.0, 2.0, "half the width of the face; chosen here", (0.1, 0.3)),
        Parameter(
            "steepest_deg", "deg", 90.0, 10.0, 90.0, "incidence of the last ray that is returned; chosen here", (60.0,)
        ),
    )
    half_deg: Tensor
    half_width_m: Tensor
    steepest_deg: Tensor

    def apply(self, state: State) -> State:
        """Move the direct path to the nearest visible point of the face, and lose it where there is none."""
        c = state.conditions
        normal, view = c.angle - c.incidence, torch.deg2rad(self.half_deg)
        along, across = self.half_width_m * torch.sin(c.incidence), self.half_width_m * torch.cos(c.incidence)
        low = torch.maximum(c.angle - torch.atan2(across, c.distance - along), -view)
        high = torch.minimum(c.angle + torch.atan2(across, c.distance + along), view)
        apart = torch.relu(low - high)  # of the view and the face, whose middle stands for a ray
        ray = torch.maximum(low - 0.5 * apart, torch.minimum(normal, high + 0.5 * apart))
        steep = (ray - normal).abs()
        outside = apart + torch.relu(steep - torch.deg2rad(self.steepest_deg))
        length = c.distance * torch.cos(c.incidence) / torch.clamp(torch.cos(steep), min=LEAST_COSINE)
        level = state.direct.level_db - EDGE_DB_PER_RAD * outside
        return state.with_direct(
            replace(state.direct, length=state.direct.length - c.distance + length, level_db=level)
        )

    def statement(self) -> str:
        """Return a sentence with the full field of view."""
        return f"{self.summary}, over {2 * self.values['half_deg']:.0f} deg."
