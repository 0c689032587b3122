"""The tracks: fixed streets in which the sonars are the waveform rig, the wheels are worn, and two sonars are damaged.

On each car one sonar has been knocked out of its place, and one has a loose contact. Neither is known to the driver.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from acquisition.arrays import Bits
from noise import load_model
from noise.rig import SIMULATED
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.sensing.odometry import ODOMETRIES
from sonar_gym.street.randomization import Drawn, Randomization
from sonar_gym.street.street import LEVELS
from sonar_gym.street.vehicle import CarSettings
from training.agents.evaluate import DriverPool, Outcomes, evaluate
from training.agents.sonars import LooseContact, MismatchedModel
from training.common.checksum import canonical, sha256

DIGITS = 9  # of the numbers of a street that are hashed; their last bits may differ between machines


@dataclass(frozen=True)
class OneDisplaced(Randomization):
    """One sonar of each car, any of them, stands elsewhere than the driver assumes.

    Attributes:
        along: greatest displacement along and across the car, m.
        turn_deg: greatest turn, deg.
    """

    along: float = 0.0
    turn_deg: float = 0.0

    def draw(self, rng: np.random.Generator, sonars: int) -> Drawn:
        """Draw the sonar and its displacement, uniform within the limits."""
        moved = np.zeros((sonars, 3))
        limits = np.array([self.along, self.along, math.radians(self.turn_deg)])
        moved[rng.integers(sonars)] = limits * rng.uniform(-1.0, 1.0, 3)
        return Drawn(-1, moved)


@dataclass(frozen=True)
class Track:
    """Streets and damage of one track; the sizes of the damage are chosen here.

    Attributes:
        difficulty: name of the level of the streets.
        streets: number of streets.
        first_seed: seed of the first street; the others follow.
        odometry: name of the errors of the odometry.
        displaced: what happened to one sonar.
        loose: share of arbitrary readings of one sonar, 0..1.
        sonar: name of the model of the readings.
        assumed: name of the model from which credence is computed.
    """

    difficulty: str
    streets: int
    first_seed: int = 500_000
    odometry: str = "worn"
    displaced: OneDisplaced = field(default_factory=lambda: OneDisplaced(along=0.03, turn_deg=25.0))
    loose: float = 0.7
    sonar: str = "rig"
    assumed: str = "srf08-mlp"

    @property
    def seeds(self) -> range:
        """Seeds of the streets."""
        return range(self.first_seed, self.first_seed + self.streets)

    @property
    def world(self) -> dict[str, Any]:
        """Settings of `SonarParkingVectorEnv` without the sonar."""
        return {"difficulty": self.difficulty, "odometry": self.odometry, "randomize": self.displaced, "threads": 1}

    def drive(self, pool: Callable[[int], DriverPool], on_progress: Callable[[int, int], None]) -> Outcomes:
        """Drive every street once."""
        actual = LooseContact(load_model(self.sonar), self.loose, len(LAYOUTS["eight"]))
        sonar = MismatchedModel(actual, load_model(self.assumed))
        return evaluate(pool, {**self.world, "sonar": sonar}, self.seeds, on_progress, pooled=True)

    @property
    def definition(self) -> dict[str, Any]:
        """All that defines the track, as plain data."""
        settings = {
            "track": asdict(self),
            "street": asdict(LEVELS[self.difficulty]),
            "odometry": asdict(ODOMETRIES[self.odometry]),
            "car": asdict(CarSettings()),
            "mounts": [asdict(mount) for mount in LAYOUTS["eight"]],
            "rig": repr(SIMULATED),
        }
        return {**settings, "streets": self._digest_of_streets()}

    def _digest_of_streets(self) -> str:
        """Return the SHA-256 of the streets, starts and mounts of all cars."""
        envs = SonarParkingVectorEnv(self.streets, **self.world)
        envs.reset(seed=list(self.seeds))
        parts = [envs.fleet.worlds.mounts]
        for street in envs.fleet.streets:
            assert street is not None  # placed by the reset
            parts += [street.strip, np.array(street.gap), street.start]
        envs.close()
        return sha256(b"".join((np.round(part, DIGITS) + 0.0).tobytes() for part in parts))


TRACKS = {"hard": Track("hard", 64), "manoeuvre": Track("manoeuvre", 32)}


def board_checksum() -> str:
    """Return the SHA-256 of all that defines the tracks."""
    return sha256(canonical({name: track.definition for name, track in TRACKS.items()}))


def drive_all(pool: Callable[[int], DriverPool], on_progress: Callable[[str, int, int], None]) -> dict[str, Outcomes]:
    """Drive all tracks; progress is reported by the name of the track."""
    return {
        name: track.drive(pool, lambda done, total, name=name: on_progress(name, done, total))  # type: ignore[misc]
        for name, track in TRACKS.items()
    }


def digits(bits: Bits) -> str:
    """Return bits as a text of 0 and 1.

    >>> digits(np.array([True, False]))
    '10'
    """
    return "".join("1" if bit else "0" for bit in bits)
