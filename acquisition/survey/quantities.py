"""Quantities that a survey can vary: column of the recording, limits, and whether they are changed by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from acquisition.errors import SettingError


@dataclass(frozen=True)
class Quantity:
    """One quantity of a survey.

    Attributes:
        label: description for the operator.
        unit: for messages; "" if dimensionless.
        low, high: limits, both included.
        by_hand: the operator moves, turns or swaps something; otherwise it is a register of the sonar.
        whole: only whole numbers are valid.
    """

    label: str
    unit: str
    low: float
    high: float
    by_hand: bool = True
    whole: bool = False

    def check(self, value: float, where: str) -> None:
        """Raise SettingError for a value outside the limits.

        Raises:
            SettingError: the message gives `where`, the limits and the value with its unit.
        """
        kind = "a whole number" if self.whole else "a number"
        if not math.isfinite(value) or not self.low <= value <= self.high or (self.whole and value != int(value)):
            unit = f" {self.unit}" if self.unit else ""
            raise SettingError(
                f"{where}: expected {kind} from {self.low:g} to {self.high:g}{unit}, got {value:g}{unit}"
            )

    def text(self, value: float) -> str:
        """Return the value with its unit."""
        return f"{value:g} {self.unit}".rstrip()


# the quantities of every condition
CONDITION_QUANTITIES: Mapping[str, Quantity] = {
    "distance_mm": Quantity("distance", "mm", 0.0, 100_000.0),
    "angle_deg": Quantity("bearing of the reflector", "deg", -180.0, 180.0),
    "incidence_deg": Quantity("incidence (0: the reflector faces the sonar)", "deg", -180.0, 180.0),
    "reflectance": Quantity("reflectance", "", 0.0, 1.0),
}
# additional quantities that a plan can sweep; each becomes a column of the recording
SWEEPS: Mapping[str, Quantity] = {
    "height_mm": Quantity("height of sensor and reflector above the floor", "mm", 50.0, 10_000.0),
    "pitch_deg": Quantity("pitch of the sensor, positive upwards", "deg", -90.0, 90.0),
    "neighbour_gap_mm": Quantity("gap to the second sonar", "mm", 0.0, 10_000.0),
    "neighbour_turn_deg": Quantity("direction of the second sonar (0: beside, 90: above)", "deg", 0.0, 90.0),
    "neighbour_period_s": Quantity("interval between pings of the second sonar (0: off)", "s", 0.0, 3600.0),
    "loose_share": Quantity("share of pings disturbed by loose wires (0: soldered)", "", 0.0, 1.0),
    "gain": Quantity("gain code", "", 0.0, 31.0, by_hand=False, whole=True),
    "range_register": Quantity("range register", "", 0.0, 255.0, by_hand=False, whole=True),
}
QUANTITIES: Mapping[str, Quantity] = {**CONDITION_QUANTITIES, **SWEEPS}
