"""Front ends of other sensors than the SRF08, as limits within which their units and rooms are drawn.

- HC-SR04: two open transducers of 16 mm, one amplifier of fixed gain, and a comparator whose threshold falls after the
  burst; the host times its echo line.
- MaxBotix MB1xxx: one transducer that rings down and then listens, an amplifier whose gain rises, a firmware that
  reports nothing nearer than 0.2 or 0.3 m, corrects the speed of sound and filters its last readings.

No data sheet states the electronics; what has no source is a project choice. All bursts are of 40 kHz, also those of
MaxBotix, which states 42 kHz.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from acquisition.bench.laboratory.setup import Room
from acquisition.bench.laboratory.unit import DEG, Unit

Drawn = dict[str, Any]

# -6 dB, there and back, 16 to 24 deg off the axis, from transducers of 16 mm; the data sheet's "effectual angle" is
# below 15 deg. 4 m on a wall; falling threshold
HCSR04 = {
    "q_tx": (15.0, 45.0),
    "q_rx": (15.0, 45.0),
    "f_tx": (39.0e3, 41.0e3),
    "f_rx": (39.0e3, 41.0e3),
    "f_slope": (-60.0, -20.0),
    "radius": (5.5e-3, 8.0e-3),
    "sensitivity_db": (-12.0, 2.0),
    "noise": (1.0 / 7.0, 0.2),
    "hysteresis": (0.0, 0.10),
    "rail": (3.0, 8.0),
    "recovery": (25e-6, 75e-6),
    "t_offset": (-150e-6, 50e-6),
    "blanking": (60e-6, 200e-6),
    "rearm": (1e-3, 4e-3),
    "yaw": (-4.0 * DEG, 4.0 * DEG),
    "pitch": (-4.0 * DEG, 4.0 * DEG),
    "clock_error": (-0.015, 0.015),
    "leak_db": (-60.0, -40.0),
    "leak_delay": (60e-6, 90e-6),
    "spill": (0.0, 0.02),
}
# HRLV, XL: 5 to 7.65 m; one transducer, so that both legs share resonance and quality; 300 or 200 mm at least
MAXBOTIX = {
    "f_slope": (-60.0, -20.0),
    "radius": (5.0e-3, 8.0e-3),
    "sensitivity_db": (-4.0, 10.0),
    "noise": (1.0 / 8.0, 1.0 / 6.0),
    "hysteresis": (0.0, 0.10),
    "recovery": (50e-6, 100e-6),
    "t_offset": (-100e-6, 20e-6),
    "blanking": (0.5e-3, 1.2e-3),
    "rearm": (1e-3, 4e-3),
    "yaw": (-2.0 * DEG, 2.0 * DEG),
    "pitch": (-2.0 * DEG, 2.0 * DEG),
    "clock_error": (-0.005, 0.005),
    "leak_db": (-60.0, -45.0),  # what is left of the ring-down after blanking, which is calibrated at each ping
    "gain_step_s": (70e-6, 400e-6),
    "spill": (0.0, 0.01),
}
FILTERS = (1, 3, 5)  # number of readings of which a MaxBotix reports the median or the mean
NEAREST_S = (0.2 * 5.8e-3, 0.3 * 5.8e-3)  # s; 0.2 m (XL) and 0.3 m (HRLV) there and back
FLOOR_SCATTER_DB = (None, -30.0, -20.0)  # smooth, carpet, gravel


def _within(limits: Mapping[str, tuple[float, float]], rng: np.random.Generator) -> Drawn:
    return {name: float(rng.uniform(*pair)) for name, pair in limits.items()}


def _hcsr04(rng: np.random.Generator) -> Drawn:
    # the threshold begins 20 to 60 times higher and falls within milliseconds, so that the burst does not trip it
    raised = {"sag": -float(rng.uniform(20.0, 60.0)), "sag_tau_s": float(rng.uniform(0.15e-3, 0.6e-3))}
    tick = float(rng.choice((1e-6, 4e-6, 8e-6)))
    return {**_within(HCSR04, rng), **raised, "gain_step_s": 0.0, "baseline": 0.026, "tick": tick}


def _maxbotix(rng: np.random.Generator) -> Drawn:
    frequency, quality = float(rng.uniform(39.5e3, 40.5e3)), float(rng.uniform(20.0, 58.0))
    one = {"f_tx": frequency, "f_rx": frequency, "q_tx": quality, "q_rx": quality, "baseline": 0.0, "leak_delay": 0.0}
    filtered = {"averaging": int(rng.choice(FILTERS)), "average": str(rng.choice(("mean", "median")))}
    nearest = float(rng.choice(NEAREST_S))
    return {**_within(MAXBOTIX, rng), **one, **filtered, "nearest_s": nearest, "compensated": True}


@dataclass(frozen=True)
class FrontEnd:
    """One kind of sensor.

    Attributes:
        drawn: draws the parameters of a unit.
        seed: of its units, beside their serial numbers.
        settings: of `Setup`: registers and output.
        step_m: of its readings, m.
    """

    drawn: Callable[[np.random.Generator], Drawn]
    seed: int
    settings: Mapping[str, Any] = field(default_factory=dict)
    step_m: float = 0.001

    def unit(self, serial: int) -> Unit:
        """Return the unit of a serial number, the same in every process."""
        return Unit(serial=serial, **self.drawn(np.random.default_rng([serial, self.seed])))

    def room(self, rng: np.random.Generator) -> Room:
        """Draw a room: these sensors are often mounted low, where the floor answers."""
        height = float(np.exp(rng.uniform(np.log(0.1), np.log(1.5))))
        return Room(height, float(rng.uniform(2.3, 3.5)), floor_scatter_db=FLOOR_SCATTER_DB[rng.integers(3)])


# listening: 38 ms of an HC-SR04's echo line; 44 ms are the 7.65 m of an XL
FRONT_ENDS: Mapping[str, FrontEnd] = {
    "hcsr04": FrontEnd(_hcsr04, 0x5404, {"gain": 31, "range_register": 147, "output": "us"}),
    "maxbotix": FrontEnd(_maxbotix, 0x3B10, {"gain": 31, "range_register": 172, "output": "us"}),
}
