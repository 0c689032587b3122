"""SonarParkingGoal-v0: the parking task as a goal environment, for hindsight experience replay."""

from __future__ import annotations

from typing import Any, Unpack

import numpy as np
from gymnasium import spaces
from gymnasium.spaces.utils import flatten, flatten_space
from numpy.typing import ArrayLike, NDArray

from acquisition import SettingError
from acquisition.arrays import Floats, Singles
from acquisition.limits import Count, as_numbers, check_value
from sonar_gym.parking.environment import ODOMETRY_SPAN, SonarParkingEnv
from sonar_gym.parking.settings import ParkingSettings
from sonar_gym.street.cost_to_go import Space, cost_table, costs_to_go, tabulated
from sonar_gym.street.street import Goal, rear_room

GOAL, LENGTH = 6, 4  # numbers of a goal, and which of them is the length of the space
DISCOUNT = 0.95  # at which waiting costs as much per metre as a crash
LONGEST = 100.0  # m; limit of the length of a space
THERE_M = 0.01  # m; cost to go of a car at its goal


def relative_pose(achieved: Any, desired: Any) -> tuple[Any, Any, Any, Any]:
    """Return the pose of a goal achieved in the frame of that desired, of arrays or tensors (..., 6), each (...).

    Returns:
        x and y, m, cosine and sine of the heading.
    """
    c, s, cosine, sine = desired[..., 2], desired[..., 3], achieved[..., 2], achieved[..., 3]
    dx, dy = achieved[..., 0] - desired[..., 0], achieved[..., 1] - desired[..., 1]
    return c * dx + s * dy, c * dy - s * dx, c * cosine + s * sine, c * sine - s * cosine


class SonarParkingGoalEnv(SonarParkingEnv):
    """`SonarParking-v0` with a goal in the observation (Andrychowicz et al. 2017).

    The car is told the pose at which it has to stand, in the frame of its odometry, and the sonars show what is in the
    way. Streets, actions, starts, ends and `info` are those of `SonarParkingEnv`.

    ## Observation Space

    `Dict` of float32 vectors:

    | Key | Shape | Meaning |
    |---|---|---|
    | `observation` | (4 n + 7,) | observation of `SonarParkingEnv`, flattened in the order of its keys |
    | `achieved_goal` | (6,) | x and y, m, cosine and sine of the heading, by odometry; space, m; 1 if crashed |
    | `desired_goal` | (6,) | pose of the car in the gap in the same frame; length of the space, m; 0 |

    ## Rewards

    `compute_reward`, with the weights of `RewardWeights`: 0 at the goal; elsewhere -0.05 and -0.25 per metre of cost to
    go (`cost_to_go`) of the pose achieved into a space around the pose desired; -3 and -5 per metre for a collision or
    for leaving the street, without regard to `info`. At a discount of 0.95 that is 2 more than to wait there for ever:
    beside the gap, a crash that cost as much everywhere would cost much more than to wait. The straight distance would
    not do: beside the gap it is small, but a car cannot move sideways. `info["reward_terms"]` holds the terms of
    `SonarParkingEnv`, which are not used.

    ## Time

    An action is held for 0.4 s, so that it has an effect: within 0.1 s servo and motor hardly follow, and random
    actions cancel out. An episode is truncated after 100 actions.

    Args:
        hold: number of steps of 0.1 s for which an action is held.
        settings: keyword arguments of `SonarParkingEnv` except `reward`.
    """

    def __init__(self, hold: Count = 4, **settings: Unpack[ParkingSettings]) -> None:
        check_value("hold", hold, Count)
        if "reward" in settings:
            raise SettingError("SonarParkingGoal-v0 takes no reward: its reward is the cost to go to the goal")
        super().__init__(**settings)
        self.hold = hold
        self._own_space = self.observation_space
        limit = np.array([*ODOMETRY_SPAN, 1.0, 1.0, LONGEST, 1.0], dtype=np.float32)
        goal = spaces.Box(-limit, limit)
        self.observation_space = spaces.Dict(
            {"observation": flatten_space(self._own_space), "achieved_goal": goal, "desired_goal": goal}
        )
        self._desired: Singles = np.zeros(GOAL, dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Draw a street, place the car at its start, and compute the goal in the frame of the start."""
        observation, info = super().reset(seed=seed, options=options)
        self._desired = self._goal()
        return self._with_goal(observation, False), info

    def step(self, action: ArrayLike) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Hold the given steering and speed commands for `hold` steps of 0.1 s, or until the episode ends."""
        for _ in range(self.hold):
            observation, _, terminated, truncated, info = super().step(action)
            if terminated:
                break
        shown = self._with_goal(observation, info["collision"] or info["left_street"])
        reward = float(self.compute_reward(shown["achieved_goal"], shown["desired_goal"], info))
        return shown, reward, terminated, truncated, info

    def compute_reward(self, achieved_goal: Singles, desired_goal: Singles, info: object) -> NDArray[np.float64]:
        """Return the reward of one goal achieved, or of several.

        Args:
            achieved_goal: goals achieved, (6,) or (k, 6).
            desired_goal: goals to achieve, (6,) or (k, 6).
            info: not used.

        Returns:
            Rewards, () or (k,).
        """
        goals = [as_numbers(*one) for one in (("achieved_goal", achieved_goal), ("desired_goal", desired_goal))]
        if any(goal.shape != goals[0].shape or goal.shape[-1:] != (GOAL,) for goal in goals):
            shapes = " and ".join(str(goal.shape) for goal in goals)
            raise SettingError(f"achieved_goal and desired_goal: expected equal shapes (..., {GOAL}), got {shapes}")
        cost, weights = self._cost(*goals), self.fleet.reward_weights
        waits = np.where(cost > THERE_M, weights.time + (1.0 - DISCOUNT) * weights.crash_distance * cost, 0.0)
        return np.where(goals[0][..., -1] > 0.5, weights.crashed + weights.crash_distance * cost, waits)

    def _cost(self, achieved: Floats, desired: Floats) -> Floats:
        """Return the costs to go of goals achieved, m, () or (k,)."""
        along, across, cosine, sine = relative_pose(achieved, desired)
        pose = np.stack([along, across, np.arctan2(sine, cosine)], axis=-1).reshape(-1, 3).astype(np.float64)
        lengths, cost = desired[..., LENGTH].ravel(), np.empty(along.size)
        for length in np.unique(lengths):
            cost[lengths == length] = self._costs(pose[lengths == length], round(float(length), 6))
        return cost.reshape(along.shape)

    def _costs(self, poses: Floats, length: float) -> Floats:
        """Return the costs to go of poses relative to the goal in a space, m, (k,)."""
        car = self.fleet.car_settings
        space = Space.of(self.fleet.street_settings, car, length)
        stand = car.rear_overhang + rear_room(length, car), -space.line - 0.5 * space.depth, 0.0
        return costs_to_go(poses + stand, *cost_table(space))

    def _goal(self) -> Singles:
        """Return the pose at the end of the reference path in the frame of the start, its space, and no crash, (6,)."""
        street = self.street
        goal, (x, y, heading) = Goal.of(street, self.fleet.car_settings), street.start
        c, s = np.cos(heading), np.sin(heading)
        ahead: Floats = np.array([goal.x - x, goal.y - y])
        length = tabulated(street.gap[1] - street.gap[0], street.settings.gap[0], self.fleet.car_settings)
        return np.array([ahead @ (c, s), ahead @ (-s, c), c, -s, length, 0.0], dtype=np.float32)

    def _with_goal(self, observation: dict[str, Any], crashed: bool) -> dict[str, Any]:
        cosine, sine, x, y = observation["ego"][2:6]
        pose = x * ODOMETRY_SPAN[0], y * ODOMETRY_SPAN[1], cosine, sine
        achieved = np.array([*pose, self._desired[LENGTH], crashed], dtype=np.float32)
        flat = flatten(self._own_space, observation)
        return {"observation": flat, "achieved_goal": achieved, "desired_goal": self._desired.copy()}
