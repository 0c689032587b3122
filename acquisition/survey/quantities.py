"""What a survey can vary: each quantity with its column, limits, and whether somebody has to move something for it.

Names are those of a recording's columns, units included.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from acquisition.errors import SettingError


@dataclass(frozen=True)
class Quantity:
    """One thing that a survey varies.

    Attributes:
        what: it is, as an operator would say it.
        unit: for messages; "" where it has none.
        low, high: limits, both included.
        by_hand: somebody has to move, turn or swap something; otherwise the sonar is told over its wire.
        whole: only whole numbers make sense.
    """

    what: str
    unit: str
    low: float
    high: float
    by_hand: bool = True
    whole: bool = False

    def check(self, value: float, where: str) -> None:
        """Refuse a value outside the limits.

        Raises:
            SettingError: naming `where`, the limits and the value with its unit.
        """
        kind = "a whole number" if self.whole else "a number"
        if not math.isfinite(value) or not self.low <= value <= self.high or (self.whole and value != int(value)):
            unit = f" {self.unit}" if self.unit else ""
            raise SettingError(
                f"{where}: expected {kind} from {self.low:g} to {self.high:g}{unit}, got {value:g}{unit}"
            )

    def say(self, value: float) -> str:
        """Return the value with its unit."""
        return f"{value:g} {self.unit}".rstrip()


# the condition of every ping
CONDITIONS: Mapping[str, Quantity] = {
    "distance_mm": Quantity("distance", "mm", 0.0, 100_000.0),
    "angle_deg": Quantity("bearing of the reflector", "deg", -180.0, 180.0),
    "incidence_deg": Quantity("incidence (0: the reflector faces the sonar)", "deg", -180.0, 180.0),
    "reflectance": Quantity("reflectance", "", 0.0, 1.0),
}
# what a plan may sweep besides; a recording keeps each as a column of that name
SWEEPS: Mapping[str, Quantity] = {
    "height_mm": Quantity("height of sensor and reflector over the floor", "mm", 50.0, 10_000.0),
    "pitch_deg": Quantity("pitch of the sensor, upwards", "deg", -90.0, 90.0),
    "neighbour_gap_mm": Quantity("gap to the second sonar", "mm", 0.0, 10_000.0),
    "neighbour_turn_deg": Quantity("direction of the second sonar, 0 beside and 90 above", "deg", 0.0, 90.0),
    "neighbour_period_s": Quantity("interval of the second sonar's pings, 0 for silent", "s", 0.0, 3600.0),
    "loose_share": Quantity("looseness of the wires, 0 soldered", "", 0.0, 1.0),
    "gain": Quantity("gain code", "", 0.0, 31.0, by_hand=False, whole=True),
    "range_register": Quantity("range register", "", 0.0, 255.0, by_hand=False, whole=True),
}
QUANTITIES: Mapping[str, Quantity] = {**CONDITIONS, **SWEEPS}
