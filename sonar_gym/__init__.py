"""Gymnasium environments and wrappers with realistic sonar.

Importing this package registers `SonarParking-v0`. The public names are listed in `__init__.pyi` and imported on first
use; PyTorch is imported only by models that need it.
"""

import gymnasium
import lazy_loader

from acquisition.name_check import check_noise

__getattr__, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
ENV_ID = "SonarParking-v0"
__all__ += ["ENV_ID"]

check_noise()
if ENV_ID not in gymnasium.registry:
    gymnasium.register(
        id=ENV_ID,
        entry_point="sonar_gym.parking.environment:SonarParkingEnv",
        vector_entry_point="sonar_gym.parking.vector:SonarParkingVectorEnv",
        max_episode_steps=400,
    )


def __dir__() -> list[str]:
    """Return the public names, whether or not they have been imported."""
    return list(__all__)
