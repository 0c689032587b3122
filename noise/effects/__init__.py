"""The catalogue of effects: one literal table, by id. Signatures and confounds are told in docs/catalogue.md."""

from noise.effects.base import Atom, Conditions, Effect, Parameter, Path, Stage, State
from noise.effects.link import DroppedReading, Spike, StaleRepeat
from noise.effects.medium import AirAbsorption, SoundSpeed
from noise.effects.receiver import ClockScale, Sensitivity, TravelTimeJitter, ZeroOffset

CATALOGUE: dict[str, type[Effect]] = {
    "sound_speed": SoundSpeed,
    "air_absorption": AirAbsorption,
    "sensitivity": Sensitivity,
    "travel_time_jitter": TravelTimeJitter,
    "clock_scale": ClockScale,
    "zero_offset": ZeroOffset,
    "dropped_reading": DroppedReading,
    "stale_repeat": StaleRepeat,
    "spike": Spike,
}

__all__ = ["CATALOGUE", "Atom", "Conditions", "Effect", "Parameter", "Path", "Stage", "State"]
