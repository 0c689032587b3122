"""Settings of a condition applied to the rig: height, pitch, second sonar, loose wires, registers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from acquisition.bench import Bus, Neighbour, Rig
from acquisition.bench.acoustics.transducer import OMEGA, Piston
from acquisition.bench.laboratory.shapes import surface_of
from acquisition.survey.plan import Condition

Values = Mapping[str, float]
HOUSING_MM = (43.0, 20.0)  # width and height of an SRF08 (its manual)
SPEED = 343.4  # m/s at 19 degC
# shares of the failure modes among the pings disturbed by loose wires, and the duration of a disturbance; chosen here:
# Esmi (2016) states that wires were not soldered, but reports no failures
FAILURE_SHARES = {"nack": 0.4, "all_ones": 0.2, "lost_write": 0.2, "dropped": 0.1, "bit_flip": 0.1}
DWELL_S = 0.5


def apply_settings(rig: Rig, condition: Condition) -> Rig:
    """Return the rig with the swept settings of a condition; the same rig if nothing is swept."""
    values = condition.values
    for names, change in CHANGES:
        if any(name in values for name in names):
            rig = change(rig, values)
    return rig


def _registers(rig: Rig, values: Values) -> Rig:
    setup = rig.setup
    gain, reach = int(values.get("gain", setup.gain)), int(values.get("range_register", setup.range_register))
    return replace(rig, setup=replace(setup, gain=gain, range_register=reach))


def _height(rig: Rig, values: Values) -> Rig:
    return replace(rig, setup=replace(rig.setup, room=replace(rig.setup.room, height=values["height_mm"] * 1e-3)))


def _pitch(rig: Rig, values: Values) -> Rig:
    return replace(rig, unit=replace(rig.unit, pitch=rig.unit.pitch + np.deg2rad(values["pitch_deg"])))


def _loose_wires(rig: Rig, values: Values) -> Rig:
    rates = {name: share * values["loose_share"] for name, share in FAILURE_SHARES.items()}
    return replace(rig, setup=replace(rig.setup, bus=Bus(**rates, dwell_s=DWELL_S)))


def _neighbour(rig: Rig, values: Values) -> Rig:
    return replace(rig, setup=replace(rig.setup, neighbour=neighbour(values, rig.unit.radius)))


def neighbour(values: Values, radius: float) -> Neighbour | None:
    """Return a parallel second sonar, received by way of the reflector; the housings block the direct path.

    Args:
        values: `neighbour_period_s` (0 or missing: off), `neighbour_gap_mm`, `neighbour_turn_deg` and the condition.
        radius: of a transducer, m.
    """
    period_s = values.get("neighbour_period_s", 0.0)
    if period_s == 0.0:
        return None
    turn = np.deg2rad(values.get("neighbour_turn_deg", 0.0))
    offset_mm = values.get("neighbour_gap_mm", 0.0) + float(
        np.hypot(np.cos(turn) * HOUSING_MM[0], np.sin(turn) * HOUSING_MM[1])
    )
    emitted = float(Piston(OMEGA * radius / SPEED)(np.array(np.deg2rad(values["angle_deg"]))))
    reflected = max(abs(surface_of(values["reflectance"])) * abs(emitted), 1e-6)
    return Neighbour(
        period_s=period_s,
        path_m=max(float(np.hypot(2.0 * values["distance_mm"], offset_mm)) * 1e-3, 0.01),
        bearing_deg=values["angle_deg"],
        strength_db=20.0 * float(np.log10(reflected)),
    )


# the change to apply if a condition sweeps any of the named quantities
CHANGES: tuple[tuple[tuple[str, ...], Callable[[Rig, Values], Rig]], ...] = (
    (("gain", "range_register"), _registers),
    (("height_mm",), _height),
    (("pitch_deg",), _pitch),
    (("loose_share",), _loose_wires),
    (("neighbour_gap_mm", "neighbour_turn_deg", "neighbour_period_s"), _neighbour),
)
