"""Further obstacles of a street by kind: size, material and movement, given one by one or drawn with the street.

A street is a model at a scale of 1:10. Drawn obstacles stand or move on the left of the lane, where no car has to pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from acquisition import SettingError
from acquisition.limits import check_choice, shown
from sonar_gym.checks import settings_of
from sonar_gym.sensing.scene import Box

# A post 15 mm thick returns 0.11 of a wall's amplitude at 1.3 m (Kuc and Siegel 1987); clothes absorb and are rough
OBSTACLES: dict[str, dict[str, float]] = {
    "pole": {"length": 0.02, "width": 0.02, "reflectance": 0.1},  # of a parked bicycle
    "hedge": {"reflectance": 0.2, "texture_deg": 40.0},  # soft and rough
    "wall": {"width": 0.02, "reflectance": 0.9},  # at any angle, by its heading
    "pedestrian": {"length": 0.03, "width": 0.05, "reflectance": 0.15, "texture_deg": 40.0},
    "car": {"length": 0.45, "width": 0.20, "reflectance": 0.9, "texture_deg": 5.0},
}
# Limits of the fields that are drawn; y is measured from the left kerb, m
DRAWN: dict[str, dict[str, tuple[float, float]]] = {
    "pole": {"y": (-0.10, -0.02)},
    "hedge": {"y": (-0.06, -0.06), "length": (0.4, 1.2), "width": (0.06, 0.10)},
    "wall": {"y": (-0.08, -0.08), "length": (0.2, 0.4), "heading": (-0.2, 0.2)},
    "pedestrian": {"y": (-0.45, -0.38), "vx": (-0.15, 0.15)},
    "car": {"y": (-0.27, -0.23), "vx": (-0.5, -0.2)},
}


def check_mappings(name: str, given: Any) -> None:
    """Raise SettingError for anything but a list of mappings."""
    if not isinstance(given, Sequence) or not all(isinstance(each, Mapping) for each in given):
        raise SettingError(f"reset option {name!r}: expected a list of mappings, got {shown(given)}")


def obstacles_of(given: Sequence[Mapping[str, Any]]) -> tuple[Box, ...]:
    """Return obstacles from mappings of the fields of `Box`, with an optional `kind` that sets some of them.

    >>> obstacles_of([{"kind": "pole", "x": 1.0, "y": -0.4}])[0].reflectance
    0.1
    """
    boxes = []
    check_mappings("obstacles", given)
    for fields in given:
        own = dict(fields)
        kind = own.pop("kind", None)
        if kind is not None:
            check_choice("obstacle of kind", kind, list(OBSTACLES))
        boxes.append(settings_of(Box, {**OBSTACLES.get(kind or "", {}), **own}))
    return tuple(boxes)


def draw_obstacles(kinds: Sequence[str], end: float, left: float, rng: np.random.Generator) -> tuple[Box, ...]:
    """Draw places and movements of obstacles beside a lane.

    Args:
        kinds: names of kinds.
        end: length of the street from x = 0, m; what comes towards the car may be twice as far away.
        left: y of the left kerb, m.
        rng: source of the draws.
    """
    return tuple(_drawn(kind, end, left, rng) for kind in kinds)


def _drawn(kind: str, end: float, left: float, rng: np.random.Generator) -> Box:
    fields = {name: float(rng.uniform(*limits)) for name, limits in DRAWN[kind].items()}
    x = float(rng.uniform(0.0, 2.0 * end if fields.get("vx", 0.0) < 0.0 else end))
    return Box(**{**OBSTACLES[kind], **fields, "x": x, "y": left + fields["y"]})
