"""What a survey varies besides the reflector, done to the rig: height, pitch, second sonar, loose wires, registers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from acquisition.bench import Bus, Neighbour, Rig
from acquisition.bench.acoustics.shapes import surface_of
from acquisition.bench.acoustics.transducer import OMEGA, Piston
from acquisition.survey.plan import Cell

Values = Mapping[str, float]
HOUSING_MM = (43.0, 20.0)  # of an SRF08, width and height (its manual)
SPEED = 343.4  # m/s at 19 degC
# of the pings that a loose wire spoils, how many it spoils in which way, and how long it stays so; ours: Esmi (2016)
# tells that wires were not soldered, and not what came of it
SPOILED = {"nack": 0.4, "all_ones": 0.2, "lost_write": 0.2, "dropped": 0.1, "bit_flip": 0.1}
DWELL_S = 0.5


def arranged(rig: Rig, cell: Cell) -> Rig:
    """Return the rig as a cell wants it; without anything swept the very same."""
    values = cell.values
    for names, arrange in ARRANGEMENTS:
        if any(name in values for name in names):
            rig = arrange(rig, values)
    return rig


def _registers(rig: Rig, values: Values) -> Rig:
    setup = rig.setup
    gain, reach = int(values.get("gain", setup.gain)), int(values.get("range_register", setup.range_register))
    return replace(rig, setup=replace(setup, gain=gain, range_register=reach))


def _height(rig: Rig, values: Values) -> Rig:
    return replace(rig, setup=replace(rig.setup, room=replace(rig.setup.room, height=values["height_mm"] * 1e-3)))


def _pitch(rig: Rig, values: Values) -> Rig:
    return replace(rig, unit=replace(rig.unit, pitch=rig.unit.pitch + np.deg2rad(values["pitch_deg"])))


def _loose(rig: Rig, values: Values) -> Rig:
    rates = {name: share * values["loose_share"] for name, share in SPOILED.items()}
    return replace(rig, setup=replace(rig.setup, bus=Bus(**rates, dwell_s=DWELL_S)))


def _neighbour(rig: Rig, values: Values) -> Rig:
    return replace(rig, setup=replace(rig.setup, neighbour=neighbour(values, rig.unit.radius)))


def neighbour(values: Values, radius: float) -> Neighbour | None:
    """Return a second sonar that looks the same way, heard by the reflector; its housing hides the direct way.

    Args:
        values: `neighbour_period_s` (0 or missing: silent), `neighbour_gap_mm`, `neighbour_turn_deg` and the condition.
        radius: of a transducer, m.
    """
    period_s = values.get("neighbour_period_s", 0.0)
    if period_s == 0.0:
        return None
    turn = np.deg2rad(values.get("neighbour_turn_deg", 0.0))
    aside = values.get("neighbour_gap_mm", 0.0) + float(
        np.hypot(np.cos(turn) * HOUSING_MM[0], np.sin(turn) * HOUSING_MM[1])
    )
    sent = float(Piston(OMEGA * radius / SPEED)(np.array(np.deg2rad(values["angle_deg"]))))
    returned = max(abs(surface_of(values["reflectance"])) * abs(sent), 1e-6)
    return Neighbour(
        period_s=period_s,
        path_m=max(float(np.hypot(2.0 * values["distance_mm"], aside)) * 1e-3, 0.01),
        bearing_deg=values["angle_deg"],
        strength_db=20.0 * float(np.log10(returned)),
    )


# which quantities call for which change
ARRANGEMENTS: tuple[tuple[tuple[str, ...], Callable[[Rig, Values], Rig]], ...] = (
    (("gain", "range_register"), _registers),
    (("height_mm",), _height),
    (("pitch_deg",), _pitch),
    (("loose_share",), _loose),
    (("neighbour_gap_mm", "neighbour_turn_deg", "neighbour_period_s"), _neighbour),
)
