"""Gymnasium environments and wrappers with a real sonar.

Importing this package registers `SonarParking-v0`; torch is imported only by models that need it.
"""

from __future__ import annotations

import importlib
from typing import Any

import gymnasium

from acquisition.name_check import check_noise

ENV_ID = "SonarParking-v0"
_LAZY = {
    "SonarParkingEnv": "sonar_gym.parking.environment",
    "SonarParkingVectorEnv": "sonar_gym.parking.vector",
    "SonarObservation": "sonar_gym.wrappers.observation",
    "SonarVectorObservation": "sonar_gym.wrappers.observation",
    "ParkingDriver": "sonar_gym.control.driver",
    "run_episode": "sonar_gym.control.driver",
}

__all__ = [
    "ENV_ID",
    "ParkingDriver",
    "SonarObservation",
    "SonarParkingEnv",
    "SonarParkingVectorEnv",
    "SonarVectorObservation",
    "run_episode",
]

check_noise()
if ENV_ID not in gymnasium.registry:
    gymnasium.register(
        id=ENV_ID,
        entry_point="sonar_gym.parking.environment:SonarParkingEnv",
        vector_entry_point="sonar_gym.parking.vector:SonarParkingVectorEnv",
        max_episode_steps=400,
    )


def __getattr__(name: str) -> Any:
    """Import what is heavier than registration on first use."""
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'sonar_gym' has no attribute {name!r}")
