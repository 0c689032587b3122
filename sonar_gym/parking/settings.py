"""Types of the settings of parking environments, for constructors that hand them on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict

from sonar_gym.parking.step_kernel import RewardWeights
from sonar_gym.sensing.mounts import Layout
from sonar_gym.sensing.odometry import OdometryChoice
from sonar_gym.sensing.sonar import SonarChoice
from sonar_gym.street.randomization import Randomization
from sonar_gym.street.street import StreetSettings
from sonar_gym.street.vehicle import CarSettings


class ParkingSettings(TypedDict, total=False):
    """Keyword arguments of `SonarParkingEnv` except `reward`."""

    sonar: SonarChoice
    sonar_layout: Layout
    street: StreetSettings | Mapping[str, object] | None
    car: CarSettings | Mapping[str, object] | None
    odometry: OdometryChoice
    render_mode: str | None
    difficulty: str
    credence_driver: str | None
    crosstalk: bool
    randomize: Randomization | Mapping[str, object] | None


class FleetSettings(ParkingSettings, total=False):
    """Keyword arguments of `SonarParkingVectorEnv` except `num_envs` and `autoreset_mode`."""

    reward: RewardWeights | Mapping[str, object] | None
    max_episode_steps: int | None
    threads: int | None
    pictured: Sequence[int]
