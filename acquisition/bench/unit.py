"""One SRF08: the electronics that no datasheet states, so that nobody can know them from the code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

DEG = np.pi / 180.0
TICKS = (1e-6, 2e-6, 4e-6, 8e-6, 16e-6, 32e-6, 64e-6)  # s; which one is unknown
# limits between which each unknown is drawn; units keep their numbers only while these keep their order
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
    """What one sensor is made of; ranges as drawn by `draw` (physics of the device: ours where unsourced).

    Attributes:
        serial: number it was drawn from.
        q_tx, q_rx: quality of each transducer's resonance; 35 is a width of 2 kHz at -6 dB.
        f_tx, f_rx: resonances at 20 degC, Hz.
        f_slope: change of both resonances with temperature, Hz/K.
        radius: effective radius of the pistons, m; 6.55 mm gives the quoted beam of 55 degrees.
        sensitivity_db: echo level over that at which a wall at 6 m just trips the comparator at full gain, dB.
        noise: rms of the noise at full gain over the comparator's threshold.
        hysteresis: of the comparator, as a share of its threshold.
        rail: level at which the amplifier clips, over the threshold.
        recovery: how long it is deaf after clipping, s.
        t_offset: what the firmware adds to a time, s.
        tick: of the timer, s.
        rounding: what the firmware does to a broken centimetre or inch.
        blanking: how long it does not listen after the burst's start, s.
        rearm: dead time after each echo, s.
        yaw, pitch: of the beam against the housing, rad.
        clock_error: relative; a positive one counts too many ticks.
        leak_db: direct sound from transmitter to receiver, against the pressure at 1 m on the axis, dB.
        leak_delay: when it begins, s.
        baseline: distance between the transducers, m.
        cold_s, warm_up_tau_s: by how much its times run long when it is switched on, s, and how fast that goes.
        averaging, average: of how many first echoes the firmware makes what; the SRF08's takes one.
        deadband: the firmware repeats its first echo until one differs by more, s; the SRF08's does not.
        ramp_tau_s: where time is measured by charging a capacitor through a resistor, not by counting: its constant, s;
            long times then read short. 0 counts.
        sag, sag_tau_s: share by which the comparator's reference is low after the burst, and how fast it recovers.
        spill: pressure that leaves and enters past the beam, by the housing, against that on the axis, each way.
        light: what the light register reads.
    """

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

    @classmethod
    def nominal(cls) -> Unit:
        """Return the middle of what is plausible."""
        return cls()

    @classmethod
    def draw(cls, serial: int) -> Unit:
        """Return the unit of a serial number: the same number is the same unit in every process."""
        rng = np.random.default_rng([serial, 0x5AF08])
        uniform = rng.uniform
        drawn: dict[str, Any] = {name: uniform(*limits) for name, limits in DRAWN_FIRST.items()}
        drawn["tick"] = float(rng.choice(TICKS))
        drawn["rounding"] = "nearest" if rng.random() < 0.5 else "down"
        drawn |= {name: uniform(*limits) for name, limits in DRAWN_LAST.items()}
        return cls(serial=serial, **drawn, light=int(rng.integers(1, 249)))
