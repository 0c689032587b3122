"""The catalogue of effects: a table of all effects by id.

base: parameters, stages and the interface of an effect. state: paths, atoms and the state that effects change.
mounting, medium, target, ringing, receiver, interping, link: the effects, by place of origin.
"""

from noise.effects.base import EchoSample, Effect, Parameter, Stage
from noise.effects.interping import AsynchronousCrosstalk, Latency, PreviousPing, SynchronousCrosstalk
from noise.effects.link import CorruptedByte, DroppedReading, NoiseBurst, Spike, StaleRepeat, Stuck
from noise.effects.medium import AirAbsorption, Scintillation, SoundSpeed, ThermalDrift
from noise.effects.mounting import BaselineParallax, BeamWidth, Boresight, PivotOffset, RayCone
from noise.effects.receiver import (
    ClockScale,
    CycleSlip,
    FalseAlarm,
    Quantisation,
    RangeGate,
    RearmDeadTime,
    Sensitivity,
    TimeWalk,
    TravelTimeJitter,
    Truncation,
    WarmUp,
    ZeroOffset,
)
from noise.effects.ringing import RingDown
from noise.effects.state import Atom, Conditions, Path, State
from noise.effects.target import (
    BackgroundReflector,
    EdgeDiffraction,
    FixedClutter,
    Multipath,
    PerpendicularFoot,
    ReflectanceLoss,
    RepeatedBounce,
    SpecularLoss,
)

CATALOGUE: dict[str, type[Effect]] = {
    "sound_speed": SoundSpeed,
    "thermal_drift": ThermalDrift,
    "air_absorption": AirAbsorption,
    "scintillation": Scintillation,
    "beam_width": BeamWidth,
    "boresight": Boresight,
    "pivot_offset": PivotOffset,
    "baseline_parallax": BaselineParallax,
    "ray_cone": RayCone,
    "zero_offset": ZeroOffset,
    "reflectance_loss": ReflectanceLoss,
    "specular_loss": SpecularLoss,
    "edge_diffraction": EdgeDiffraction,
    "perpendicular_foot": PerpendicularFoot,
    "background_reflector": BackgroundReflector,
    "fixed_clutter": FixedClutter,
    "multipath": Multipath,
    "repeated_bounce": RepeatedBounce,
    "sensitivity": Sensitivity,
    "travel_time_jitter": TravelTimeJitter,
    "time_walk": TimeWalk,
    "cycle_slip": CycleSlip,
    "ring_down": RingDown,
    "rearm_dead_time": RearmDeadTime,
    "false_alarm": FalseAlarm,
    "quantisation": Quantisation,
    "truncation": Truncation,
    "range_gate": RangeGate,
    "clock_scale": ClockScale,
    "warm_up": WarmUp,
    "latency": Latency,
    "previous_ping": PreviousPing,
    "synchronous_crosstalk": SynchronousCrosstalk,
    "asynchronous_crosstalk": AsynchronousCrosstalk,
    "dropped_reading": DroppedReading,
    "stale_repeat": StaleRepeat,
    "stuck": Stuck,
    "spike": Spike,
    "noise_burst": NoiseBurst,
    "corrupted_byte": CorruptedByte,
}

__all__ = ["CATALOGUE", "Atom", "Conditions", "EchoSample", "Effect", "Parameter", "Path", "Stage", "State"]
