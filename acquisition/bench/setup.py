"""The laboratory around a unit: its settings, the air, the stand, the room and the wire."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from acquisition.bench.acoustics.air import Gradient
from acquisition.bench.acoustics.interference import Ambient, Hum, Mover, Neighbour, Reverberation
from acquisition.bench.acoustics.shapes import Shape
from acquisition.errors import SettingError

Output = Literal["inch", "cm", "us"]


@dataclass(frozen=True)
class Scatterer:
    """A small thing that stands about.

    Attributes:
        position_m: ahead of the sensor, to its left, and up, m.
        strength_db: pressure at 1 m from it against what meets it, dB; half a sphere's radius in metres.
    """

    position_m: tuple[float, float, float]
    strength_db: float = -26.0


@dataclass(frozen=True)
class Room:
    """Where the stands are. `None` takes a surface away; factors are amplitudes, ours.

    Attributes:
        height: of the beam's axis over the floor, m.
        ceiling: height of the ceiling over the floor, m.
        wall: distance of the wall ahead of the sensor, m; the default is beyond the usual range gate.
        left, right: distances of the walls beside it, m.
        floor_factor, ceiling_factor, wall_factor: what each returns of the pressure that meets it.
        floor_scatter_db: what a square metre of floor scatters to all sides of what meets it, dB (Lambert's law); None
            is a smooth floor, about -30 a carpet.
        clutter: small things that stand about.
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
    """The upright of the reflector's stand.

    Attributes:
        radius: or half the width of a square or flat one, m.
        behind: of its middle behind the reflector's, along its normal, m.
        profile: a round or square bar, or a flat strip; the latter two face as the reflector does.
    """

    radius: float = 0.015
    behind: float = 0.300
    profile: Literal["round", "square", "flat"] = "round"

    def __post_init__(self) -> None:
        """Refuse a profile that is not known."""
        if self.profile not in ("round", "square", "flat"):
            raise SettingError(f"Post.profile must be round, square or flat, got {self.profile!r}")


@dataclass(frozen=True)
class Bus:
    """How often the wire fails, as probabilities a ping, each independent of what the sonar hears.

    Attributes:
        nack: nobody acknowledges: no answer.
        all_ones: an open line reads 0xFF for ever: no answer.
        lost_write: the command never arrives, so the registers still hold the previous ping.
        dropped: read before the registers were filled: the answer is "no echo".
        bit_flip: one bit of the first echo's registers is read wrong.
        reset: the sensor's supply breaks down just before the ping: its registers of gain and range fall to 31 and 255
            and its echoes to none, and it works so until the host writes them again.
        rewrite_s: how often the host does so, s, counted in each run from 0; each ping is 0.
        dwell_s: after how long on average the state of the wire is drawn anew, s; 0 does so each ping.
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
        """Refuse what is no probability."""
        for name in ("nack", "all_ones", "lost_write", "dropped", "bit_flip", "reset"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise SettingError(f"Bus.{name} must lie from 0 to 1, got {value:g}: give a probability a ping")


SCATTER = ("drift_c", "scintillation_db", "jitter_m", "placement_m", "placement_deg", "tilt_deg")


@dataclass(frozen=True)
class Setup:
    """Everything about a recording that is not the unit; the defaults are the laboratory of Esmi (2016).

    Attributes:
        gain: code 0..31 of the amplifier's cap (register 1).
        range_register: 0..255; echoes are awaited for (r + 1) * 256 us (register 2).
        output: unit of the echo registers.
        temperature_c, humidity_pct: of the air. A `temperature_c` or `humidity_pct` among a ping's covariates wins.
        extra_absorption_db: what the air takes away beyond what temperature and humidity say, dB/m: fog, dust.
        drift_c, humidity_drift_pct, drift_tau_s: standard deviations of the slow wanders of temperature and humidity,
            and their correlation time.
        scintillation_db: standard deviation of an echo's level for a path of 12 m (6 m there and back), dB.
        jitter_m: standard deviation of a range at 6 m from eddies in the air, m; grows as the root of distance.
        flutter_tau_s: correlation time of scintillation and jitter, s.
        placement_m, placement_deg: scatter of where the reflector really stands at each visit of a condition, along
            the line of sight and in bearing.
        tilt_deg: scatter of its pose at each visit, about the vertical and the horizontal alike.
        sway_m, sway_period_s: how far and how fast the stand swings along the line of sight, a few millimetres.
        pivot_m: how far the reflector's face is ahead of the axis about which its stand turns; distances are marked
            with the face square to the line of sight.
        zero_m: how far behind the mark the sensor's own zero lies, m; added to every distance.
        above_m: height of the reflector's middle over the sensor, m; it stays upright.
        gradient: of the air's temperature.
        supply: voltage of the sensor's supply over 5 V; the burst grows and falls with it.
        reflector: shape in front; None takes the thesis's by the ping's reflectance.
        roughness_m: root mean square height of the reflector's surface; the mirror echo fades with its square, and what
            that loses is scattered to all sides. Mirrors and rubber are smooth; 1 mm is rough at 40 kHz.
        post: of the reflector's stand; None takes it away.
        room: around the stands.
        movers: what moves or is moved: people, furniture.
        neighbour: another sonar at work, several, or none.
        ambient: noise that comes and goes, or none.
        reverberation: what the room keeps of this burst and those before, or none.
        hum: the mains in the sensor's supply, or none.
        bus: how the wire fails.
    """

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
        """Refuse settings that the registers cannot hold."""
        check_register("gain", self.gain, 31)
        check_register("range register", self.range_register, 255)
        if self.output not in ("inch", "cm", "us"):
            raise SettingError(f"output must be inch, cm or us, got {self.output!r}")

    @classmethod
    def draw(cls, serial: int, **fixed: Any) -> Setup:
        """Return a laboratory by its number, plausible and unlike the next; `fixed` settings stay as given."""
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
    def still(cls, **fixed: Any) -> Setup:
        """Return a laboratory that holds a sensor and a reflector, and where nothing wanders, flutters or scatters."""
        nothing = dict.fromkeys(SCATTER, 0.0)
        return cls(**{**nothing, "post": None, "room": Room(None, None, None), **fixed})

    def after_reset(self) -> Setup:
        """Return the settings of a sensor whose supply broke down: full gain and range."""
        return replace(self, gain=31, range_register=255)

    @property
    def neighbours(self) -> tuple[Neighbour, ...]:
        """All other sonars at work."""
        given = self.neighbour
        return given if isinstance(given, tuple) else (given,) if given is not None else ()

    @property
    def listening(self) -> float:
        """How long echoes are awaited, s."""
        return (self.range_register + 1) * 256e-6


def check_register(name: str, value: int, high: int) -> None:
    """Refuse a register value outside 0..high.

    Raises:
        SettingError: naming register, limit and value.
    """
    if not 0 <= value <= high or value != int(value):
        raise SettingError(f"{name} must be a whole number from 0 to {high}, got {value:g}: the SRF08 holds no other")
