"""SonarParkingGoal-v0: the parking task as a goal environment, for hindsight experience replay."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.spaces.utils import flatten, flatten_space
from numpy.typing import ArrayLike, NDArray

from acquisition import SettingError
from acquisition.arrays import Floats, Singles
from acquisition.limits import as_numbers
from sonar_gym.parking.environment import ODOMETRY_SPAN, SonarParkingEnv
from sonar_gym.parking.street import Goal

# Of x and y, m, of cosine and sine of the heading, and of a crash, which must cost more than waiting: 5 m from the goal
# the discounted sum of all later rewards at a discount of 0.95 is -100
WEIGHTS = np.array([1.0, 1.0, 0.3, 0.3, 100.0])


class SonarParkingGoalEnv(SonarParkingEnv):
    """`SonarParking-v0` with a goal in the observation (Andrychowicz et al. 2017).

    The car is told the pose at which it has to stand, in the frame of its odometry, and the sonars show what is in the
    way. Streets, actions, starts, ends and `info` are those of `SonarParkingEnv`.

    ## Observation Space

    `Dict` of float32 vectors:

    | Key | Shape | Meaning |
    |---|---|---|
    | `observation` | (4 n + 7,) | observation of `SonarParkingEnv`, flattened in the order of its keys |
    | `achieved_goal` | (5,) | pose by odometry: x and y, m, cosine and sine of the heading; 1 if crashed |
    | `desired_goal` | (5,) | pose of the car in the gap in the same frame; 0 |

    ## Rewards

    `compute_reward`: minus the weighted sum of the absolute differences of the two goals, without regard to `info`; a
    collision, or leaving the street, counts 100. `info["reward_terms"]` holds the terms of `SonarParkingEnv`, which are
    not used.

    Args:
        settings: keyword arguments of `SonarParkingEnv` except `reward`.
    """

    def __init__(self, **settings: Any) -> None:
        if "reward" in settings:
            raise SettingError("SonarParkingGoal-v0 takes no reward: its reward is the distance to the goal")
        super().__init__(**settings)
        self._own_space = self.observation_space
        limit = np.array([*ODOMETRY_SPAN, 1.0, 1.0, 1.0], dtype=np.float32)
        goal = spaces.Box(-limit, limit)
        self.observation_space = spaces.Dict(
            {"observation": flatten_space(self._own_space), "achieved_goal": goal, "desired_goal": goal}
        )
        self._desired: Singles = np.zeros(len(WEIGHTS), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Draw a street, place the car at its start, and compute the goal in the frame of the start."""
        observation, info = super().reset(seed=seed, options=options)
        self._desired = self._goal()
        return self._with_goal(observation, False), info

    def step(self, action: ArrayLike) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Drive for 0.1 s with the given steering and speed commands."""
        observation, _, terminated, truncated, info = super().step(action)
        shown = self._with_goal(observation, info["collision"] or info["left_street"])
        reward = float(self.compute_reward(shown["achieved_goal"], shown["desired_goal"], info))
        return shown, reward, terminated, truncated, info

    def compute_reward(self, achieved_goal: Singles, desired_goal: Singles, info: Any) -> NDArray[np.float64]:
        """Return the reward of one goal achieved, or of several.

        Args:
            achieved_goal: goals achieved, (5,) or (k, 5).
            desired_goal: goals to achieve, (5,) or (k, 5).
            info: not used.

        Returns:
            Rewards, () or (k,).
        """
        goals = [as_numbers(*one) for one in (("achieved_goal", achieved_goal), ("desired_goal", desired_goal))]
        if any(goal.shape != goals[0].shape or goal.shape[-1:] != WEIGHTS.shape for goal in goals):
            shapes = " and ".join(str(goal.shape) for goal in goals)
            raise SettingError(
                f"achieved_goal and desired_goal: expected equal shapes (..., {len(WEIGHTS)}), got {shapes}"
            )
        difference = np.abs(goals[0] - goals[1])
        return np.asarray(-(difference @ WEIGHTS))

    def _goal(self) -> Singles:
        """Return the pose at the end of the reference path in the frame of the start, and no crash, (5,)."""
        street = self.street
        goal, (x, y, heading) = Goal.of(street, self.fleet.car_settings), street.start
        c, s = np.cos(heading), np.sin(heading)
        ahead: Floats = np.array([goal.x - x, goal.y - y])
        return np.array([ahead @ (c, s), ahead @ (-s, c), c, -s, 0.0], dtype=np.float32)

    def _with_goal(self, observation: dict[str, Any], crashed: bool) -> dict[str, Any]:
        cosine, sine, x, y = observation["ego"][2:6]
        achieved = np.array([x * ODOMETRY_SPAN[0], y * ODOMETRY_SPAN[1], cosine, sine, crashed], dtype=np.float32)
        flat = flatten(self._own_space, observation)
        return {"observation": flat, "achieved_goal": achieved, "desired_goal": self._desired.copy()}
