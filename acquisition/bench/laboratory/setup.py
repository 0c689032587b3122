"""Settings of the laboratory around a sensor: registers, air, stand, room and bus."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np

from acquisition.arguments import checked
from acquisition.bench.laboratory.air import Gradient
from acquisition.bench.laboratory.interference import Ambient, Hum, Mover, Neighbour, Reverberation
from acquisition.bench.laboratory.shapes import Shape
from acquisition.brief import brief
from acquisition.errors import SettingError
from acquisition.limits import SEEDS, check_settings

Output = Literal["inch", "cm", "us"]


@dataclass(frozen=True)
class Scatterer:
    """Small object.

    Attributes:
        position_m: ahead of the sensor, to its left, and up, m.
        strength_db: pressure at 1 m from it relative to the incident pressure, dB; for a sphere, half its radius.
    """

    position_m: tuple[float, float, float]
    strength_db: float = -26.0


@dataclass(frozen=True)
class Room:
    """Surfaces around the stands. `None` removes a surface; amplitude factors are project choices.

    Attributes:
        height: of the beam's axis above the floor, m.
        ceiling: height of the ceiling above the floor, m.
        wall: distance of the wall ahead of the sensor, m; the default is beyond the default range gate.
        left, right: distances of the side walls, m.
        floor_factor, ceiling_factor, wall_factor: reflected pressure relative to the incident pressure.
        floor_scatter_db: diffuse scattering strength of a square metre of floor, dB (Lambert's law); None is a smooth
            floor, a carpet is about -30.
        clutter: small objects.
    """

    height: float | None = 1.5
    ceiling: float | None = 3.0
    wall: float | None = 9.0
    left: float | None = None
    right: float | None = None
    floor_factor: float = 0.9
    ceiling_factor: float = 0.7
    wall_factor: float = 0.9
    floor_scatter_db: float | None = None
    clutter: tuple[Scatterer, ...] = ()


@dataclass(frozen=True)
class Post:
    """Upright post of the reflector's stand.

    Attributes:
        radius: radius, or half the width of a square or flat post, m.
        behind: distance of its axis behind the reflector's centre, along the normal, m.
        profile: round or square bar, or flat strip; square and flat posts are parallel to the reflector.
    """

    radius: float = 0.015
    behind: float = 0.300
    profile: Literal["round", "square", "flat"] = "round"

    def __post_init__(self) -> None:
        """Raise SettingError for an unknown profile."""
        if self.profile not in ("round", "square", "flat"):
            raise SettingError(f"Post.profile must be round, square or flat, got {self.profile!r}")


@dataclass(frozen=True)
class Bus:
    """Fault rates of the bus, as probabilities per ping, independent of the echo.

    Attributes:
        nack: no acknowledgement: no answer.
        all_ones: an open line reads 0xFF: no answer.
        lost_write: the ranging command is lost, so the registers still hold the previous ping.
        dropped: registers read before they are filled: "no echo".
        bit_flip: one bit of the first echo's registers is wrong.
        reset: the supply fails just before the ping: no echo, and gain and range registers of 31 and 255 until they are
            rewritten.
        rewrite_s: interval at which the host rewrites the registers, s, from 0 in each run; 0 is at each ping.
        dwell_s: mean time after which the state of the bus is redrawn, s; 0 redraws it at each ping.
    """

    nack: float = 0.0
    all_ones: float = 0.0
    lost_write: float = 0.0
    dropped: float = 0.0
    bit_flip: float = 0.0
    dwell_s: float = 0.0
    reset: float = 0.0
    rewrite_s: float = 120.0

    def __post_init__(self) -> None:
        """Raise SettingError for a rate outside 0..1."""
        for name in ("nack", "all_ones", "lost_write", "dropped", "bit_flip", "reset"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise SettingError(f"Bus.{name} must lie from 0 to 1, got {value:g}: give a probability per ping")


RANGE_STEP_MM = 43.0  # mm; step of the range register
RANDOM_SETTINGS = ("drift_c", "scintillation_db", "jitter_m", "placement_m", "placement_deg", "tilt_deg")


@dataclass(frozen=True)
class Setup:
    """All settings of a recording except the sensor's own; the defaults are the laboratory of Esmi (2016).

    Attributes:
        gain: code 0..31 of the amplifier's maximum gain (register 1).
        range_register: 0..255; the listening time is (r + 1) * 256 us (register 2).
        output: unit of the echo registers.
        temperature_c, humidity_pct: of the air, overridden by covariates of the pings of the same names.
        extra_absorption_db: absorption beyond that of clean air, dB/m: fog, dust.
        drift_c, humidity_drift_pct, drift_tau_s: standard deviations of the slow drift of temperature and humidity,
            which rise and fall together, and its correlation time.
        scintillation_db: standard deviation of an echo's level at 6 m, dB.
        jitter_m: standard deviation of a range at 6 m due to turbulence, m; proportional to the root of the distance.
        flutter_tau_s: correlation time of scintillation and jitter, s.
        placement_m, placement_deg: standard deviation of the reflector's position at each visit, along the line of
            sight and in bearing.
        tilt_deg: standard deviation of its orientation at each visit, about the vertical and the horizontal axis.
        sway_m, sway_period_s: amplitude and period of the stand's sway along the line of sight.
        pivot_m: distance of the reflector's face ahead of the stand's axis of rotation, m; distances are measured with
            the face perpendicular to the line of sight.
        zero_m: distance of the sensor's zero behind the zero of the scale, m; added to every distance.
        above_m: height of the reflector's centre above the sensor, m; the reflector remains upright.
        gradient: of the air's temperature.
        supply: supply voltage relative to 5 V; the burst's amplitude is proportional to it.
        reflector: shape of the reflector; None takes the thesis's by the ping's reflectance.
        roughness_m: root mean square height of the reflector's surface; it turns mirror echo into diffuse scattering.
            Mirrors and rubber are smooth; 1 mm is rough at 40 kHz.
        post: of the reflector's stand; None removes it.
        room: surfaces around the stands.
        movers: moving objects and persons.
        neighbour: one or several other sonars, or none.
        ambient: intermittent background noise, or none.
        reverberation: diffuse reverberation, or none.
        hum: mains ripple on the sensor's supply, or none.
        bus: fault rates of the bus.
    """

    __repr__ = brief

    gain: int = 14
    range_register: int = 140
    output: Output = "cm"
    temperature_c: float = 19.0
    humidity_pct: float = 50.0
    extra_absorption_db: float = 0.0
    drift_c: float = 0.3
    humidity_drift_pct: float = 0.0
    drift_tau_s: float = 3600.0
    scintillation_db: float = 0.6
    jitter_m: float = 0.6e-3
    flutter_tau_s: float = 2.0
    placement_m: float = 0.002
    placement_deg: float = 0.2
    tilt_deg: float = 0.3
    sway_m: float = 0.0
    sway_period_s: float = 1.3
    pivot_m: float = 0.0
    zero_m: float = 0.0
    above_m: float = 0.0
    gradient: Gradient = field(default_factory=Gradient)
    supply: float = 1.0
    reflector: Shape | None = None
    roughness_m: float = 0.0
    post: Post | None = field(default_factory=Post)
    room: Room = field(default_factory=Room)
    movers: tuple[Mover, ...] = ()
    neighbour: Neighbour | tuple[Neighbour, ...] | None = None
    ambient: Ambient | None = None
    reverberation: Reverberation | None = None
    hum: Hum | None = None
    bus: Bus = field(default_factory=Bus)

    def __post_init__(self) -> None:
        """Raise SettingError for what is not a finite number, and for values that the registers cannot hold."""
        check_settings(self)
        check_register("gain", self.gain, 31)
        check_register("range_register", self.range_register, 255)
        if self.output not in ("inch", "cm", "us"):
            raise SettingError(f"output must be inch, cm or us, got {self.output!r}")

    @classmethod
    @checked
    def draw(cls, serial: Annotated[int, SEEDS], **fixed: Any) -> Setup:
        """Return a plausible laboratory by its number; `fixed` settings are not drawn."""
        rng = np.random.default_rng([serial, 0x1AB])
        uniform = rng.uniform
        room = Room(uniform(1.0, 1.5), uniform(2.5, 3.5), uniform(7.5, 12.0))
        drawn: dict[str, Any] = {
            "temperature_c": uniform(17.0, 24.0),
            "humidity_pct": uniform(20.0, 60.0),
            "drift_c": uniform(0.1, 0.5),
            "drift_tau_s": uniform(1800.0, 7200.0),
            "scintillation_db": uniform(0.3, 1.0),
            "jitter_m": uniform(0.3e-3, 1.0e-3),
            "flutter_tau_s": uniform(1.0, 5.0),
            "placement_m": uniform(0.001, 0.004),
            "post": Post(uniform(0.005, 0.030)),
            "room": room,
            "pivot_m": uniform(0.0, 0.32),
            "humidity_drift_pct": uniform(0.0, 5.0),
        }
        return cls(**{**drawn, **fixed})

    @classmethod
    def static(cls, **fixed: Any) -> Setup:
        """Return a laboratory with only a sensor and a reflector, without drift, turbulence or placement errors."""
        nothing = dict.fromkeys(RANDOM_SETTINGS, 0.0)
        return cls(**{**nothing, "post": None, "room": Room(None, None, None), **fixed})

    def after_reset(self) -> Setup:
        """Return the settings of a sensor after a reset: full gain and range."""
        return replace(self, gain=31, range_register=255)

    @property
    def neighbours(self) -> tuple[Neighbour, ...]:
        """All other sonars."""
        given = self.neighbour
        return given if isinstance(given, tuple) else (given,) if given is not None else ()

    @property
    def listening(self) -> float:
        """Listening time, s."""
        return (self.range_register + 1) * 256e-6


def check_register(name: str, value: int, high: int) -> None:
    """Raise SettingError, naming register, limit and value, for a value outside 0..high."""
    if not 0 <= value <= high or value != int(value):
        raise SettingError(f"{name} must be a whole number from 0 to {high}, got {value:g}: the SRF08 holds no other")
