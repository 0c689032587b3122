"""Medium effects: what the air does to the time and the strength of sound."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from noise.effects.base import Effect, Parameter, Path, Stage, State

ASSUMED_SPEED = 344.83  # m/s; 58 us/cm, the constant of the HC-SR04 family and the working assumption for the SRF08
CELSIUS = 273.15
SPEED_AT_0C = 331.3  # m/s, dry air


def sound_speed(temperature_c: Tensor) -> Tensor:
    """Return the speed of sound in dry air, m/s: c = 331.3 sqrt(1 + T/273.15)."""
    return SPEED_AT_0C * (1.0 + temperature_c / CELSIUS) ** 0.5


ASSUMED_TEMPERATURE_C = CELSIUS * ((ASSUMED_SPEED / SPEED_AT_0C) ** 2 - 1.0)  # 22.8 degC: where 58 us/cm is true


class SoundSpeed(Effect):
    """Air at another temperature than the sensor assumes: range = distance * c(assumed) / c(true)."""

    name = "sound_speed"
    stage = Stage.MEDIUM
    summary = "Sound travels faster or slower than the sensor assumes: all ranges are scaled"
    parameters = (
        Parameter(
            "temperature_c",
            "degC",
            ASSUMED_TEMPERATURE_C,
            -20.0,
            60.0,
            "c = 331.3 sqrt(1+T/273.15)",
            (ASSUMED_TEMPERATURE_C,),
        ),
    )
    temperature_c: Tensor

    def apply(self, state: State) -> State:
        """Stretch every path by the ratio of speeds; exactly 1 at the assumed temperature."""
        ratio = ((CELSIUS + ASSUMED_TEMPERATURE_C) / (CELSIUS + self.temperature_c)) ** 0.5
        return state.map_paths(lambda path: replace(path, length=path.length * ratio))


class AirAbsorption(Effect):
    """Air takes `alpha_db_per_m` from the level for every metre there and back: level -> level - 2 alpha length."""

    name = "air_absorption"
    stage = Stage.MEDIUM
    summary = "Air absorbs the sound: far echoes are weaker"
    parameters = (
        Parameter("alpha_db_per_m", "dB/m", 0.0, 0.0, 3.0, "ISO 9613-1 at 40 kHz: 0.4 to 1.5 dB/m", (0.7, 1.3)),
    )
    alpha_db_per_m: Tensor

    def apply(self, state: State) -> State:
        """Weaken every path by its own length."""
        return state.map_paths(self._absorb)

    def _absorb(self, path: Path) -> Path:
        return replace(path, level_db=path.level_db - 2.0 * self.alpha_db_per_m * path.length)
