"""Electronics and transducers of one sensor: parameters that no datasheet states, by default those of an SRF08."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from acquisition.arguments import checked
from acquisition.brief import brief
from acquisition.limits import SEEDS, check_settings

DEG = np.pi / 180.0
TICKS = (1e-6, 2e-6, 4e-6, 8e-6, 16e-6, 32e-6, 64e-6)  # s; the datasheet does not state which
# limits of each unknown parameter; the order must not change, as units are drawn from it by serial number
DRAWN_FIRST = {
    "q_tx": (20.0, 58.0),
    "q_rx": (20.0, 58.0),
    "f_tx": (39.5e3, 40.5e3),
    "f_rx": (39.5e3, 40.5e3),
    "f_slope": (-60.0, -20.0),
    "radius": (6.0e-3, 7.0e-3),
    "sensitivity_db": (-6.0, 12.0),
    "noise": (1.0 / 6.0, 0.2),
    "hysteresis": (0.05, 0.10),
    "recovery": (50e-6, 100e-6),
    "t_offset": (-120e-6, 0.0),
}
DRAWN_LAST = {
    "blanking": (150e-6, 500e-6),
    "rearm": (1e-3, 4e-3),
    "yaw": (-3.0 * DEG, 3.0 * DEG),
    "pitch": (-3.0 * DEG, 3.0 * DEG),
    "clock_error": (-0.005, 0.005),
    "leak_db": (-60.0, -30.0),
    "leak_delay": (70e-6, 150e-6),
}
RANGES: Mapping[str, tuple[float, float]] = {**DRAWN_FIRST, **DRAWN_LAST}


@dataclass(frozen=True)
class Unit:
    """Parameters of one sensor; `draw` draws them within `RANGES` (project choices where no source is given).

    Attributes:
        serial: number from which it was drawn.
        q_tx, q_rx: quality factor of each transducer's resonance; 35 is a width of 2 kHz at -6 dB.
        f_tx, f_rx: resonance frequencies at 20 degC, Hz.
        f_slope: change of both resonances with temperature, Hz/K.
        q_slope: relative change of both qualities with temperature, 1/K; negative: in the cold they ring longer.
        radius: effective radius of the pistons, m; 6.55 mm gives the specified beam of 55 degrees.
        sensitivity_db: echo level relative to that at which a wall at 6 m just trips the comparator at full gain, dB.
        noise: rms of the noise at full gain relative to the comparator's threshold.
        hysteresis: of the comparator, as a fraction of its threshold.
        rail: level at which the amplifier clips, relative to the threshold of the moment.
        recovery: time without detection after clipping, s.
        t_offset: time that the firmware adds, s.
        tick: of the timer, s.
        rounding: how the firmware rounds to whole centimetres or inches.
        blanking: time without detection after the start of the burst, s.
        rearm: dead time after each echo, s.
        yaw, pitch: of the beam relative to the housing, rad.
        clock_error: relative; a positive one counts too many ticks.
        leak_db: direct sound from transmitter to receiver, relative to the pressure at 1 m on the axis, dB.
        leak_delay: delay of the direct sound, s.
        baseline: distance between the transducers, m.
        cold_s, warm_up_tau_s: excess of the measured times at power-on, s, and its time constant, s.
        averaging, average: number of first echoes averaged by the firmware, and how; 1 on a real SRF08.
        deadband: change below which the firmware repeats the previous first echo, s; 0 on a real SRF08.
        ramp_tau_s: time constant if time is measured by charging a capacitor through a resistor, s: long times then
            read short. 0 counts ticks.
        sag, sag_tau_s: relative drop of the comparator's reference after the burst, and its recovery time, s.
        spill: pressure emitted and received outside the beam, by the housing, relative to that on the axis, each way.
        light: value of the light register.
        gain_step_s: time per step of the amplifier's gain, s; 0 is the full gain from the start of the burst.
        nearest_s: time at which the firmware reports earlier echoes, s; 0 on a real SRF08.
        compensated: whether the firmware corrects times for the temperature of the air; False on a real SRF08.
    """

    __repr__ = brief

    serial: int = 0
    q_tx: float = 35.0
    q_rx: float = 35.0
    f_tx: float = 40e3
    f_rx: float = 40e3
    f_slope: float = -40.0
    radius: float = 6.55e-3
    sensitivity_db: float = 3.0
    noise: float = 0.19
    hysteresis: float = 0.07
    rail: float = 5.0
    recovery: float = 75e-6
    t_offset: float = -60e-6
    tick: float = 1e-6
    rounding: Literal["nearest", "down"] = "nearest"
    blanking: float = 250e-6
    rearm: float = 2.5e-3
    yaw: float = 0.0
    pitch: float = 0.0
    clock_error: float = 0.0
    leak_db: float = -40.0
    leak_delay: float = 100e-6
    baseline: float = 0.025
    cold_s: float = 0.0
    warm_up_tau_s: float = 600.0
    averaging: int = 1
    average: Literal["mean", "median"] = "mean"
    deadband: float = 0.0
    ramp_tau_s: float = 0.0
    sag: float = 0.0
    sag_tau_s: float = 3e-3
    spill: float = 0.0
    light: int = 92
    q_slope: float = 0.0
    gain_step_s: float = 70e-6
    nearest_s: float = 0.0
    compensated: bool = False

    @classmethod
    def nominal(cls) -> Unit:
        """Return a unit with typical parameters."""
        return cls()

    def __post_init__(self) -> None:
        """Raise SettingError for what is not a finite number, or not one of the choices."""
        check_settings(self)

    @classmethod
    @checked
    def draw(cls, serial: Annotated[int, SEEDS]) -> Unit:
        """Return the unit of a serial number, the same in every process."""
        rng = np.random.default_rng([serial, 0x5AF08])
        uniform = rng.uniform
        drawn: dict[str, Any] = {name: uniform(*limits) for name, limits in DRAWN_FIRST.items()}
        drawn["tick"] = float(rng.choice(TICKS))
        drawn["rounding"] = "nearest" if rng.random() < 0.5 else "down"
        drawn |= {name: uniform(*limits) for name, limits in DRAWN_LAST.items()}
        return cls(serial=serial, **drawn, light=int(rng.integers(1, 249)))
