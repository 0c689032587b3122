"""Gymnasium environments and wrappers with realistic sonar.

Importing this package registers the environments of `ENVIRONMENTS`. The public names are listed in `__init__.pyi` and
imported on first use; PyTorch is imported only by models that need it.
"""

from typing import Any

import lazy_loader

import acquisition

if not hasattr(acquisition, "SonarError"):  # said here, since nothing of the package that is hidden can say it
    raise ImportError(
        f"`import acquisition` finds {acquisition.__file__}, not sonar-gym: rename it, since Python finds it first"
    )
from acquisition.extras import require
from acquisition.name_check import check_names
from acquisition.version import __version__ as __version__

require("gymnasium", "gym")
import gymnasium  # noqa: E402 - the check comes first

__getattr__, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
ENV_ID = "SonarParking-v0"
MAX_EPISODE_STEPS = 400
# Each id with the difficulty of its streets, and the mean sum of rewards from which it counts as solved: about that of
# parking in nine of ten streets as slowly as the shipped agent, and in six of ten within 25 s for the manoeuvre
ENVIRONMENTS = {
    ENV_ID: ("normal", 13.0),
    "SonarParkingEasy-v0": ("easy", 10.5),
    "SonarParkingHard-v0": ("hard", 20.5),
    "SonarParkingManoeuvre-v0": ("manoeuvre", 23.0),
}
GOAL_ENV_ID = "SonarParkingGoal-v0"
__all__ += ["ENVIRONMENTS", "ENV_ID", "GOAL_ENV_ID"]


def _register(env_id: str, **spec: Any) -> None:
    if env_id not in gymnasium.registry:
        gymnasium.register(id=env_id, **{"max_episode_steps": MAX_EPISODE_STEPS, **spec})


check_names("noise")
for _id, (_difficulty, _threshold) in ENVIRONMENTS.items():
    _register(
        _id,
        entry_point="sonar_gym.parking.environment:SonarParkingEnv",
        vector_entry_point="sonar_gym.parking.vector:SonarParkingVectorEnv",
        reward_threshold=_threshold,
        kwargs={} if _difficulty == "normal" else {"difficulty": _difficulty},
    )
_register(
    GOAL_ENV_ID,
    entry_point="sonar_gym.parking.goal:SonarParkingGoalEnv",
    max_episode_steps=MAX_EPISODE_STEPS // 4,  # it holds each action for four steps
    reward_threshold=-10.0,
)


def __dir__() -> list[str]:
    """Return the public names, whether or not they have been imported."""
    return list(__all__)
