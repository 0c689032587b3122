"""A driver written by hand: parks from observations alone, and runs episodes for demonstrations.

It follows the lane by odometry and the far wall, measures the spaces between the boxes with the sonars on its right,
stops beside the first that is long enough, backs into it along two arcs, and shuffles until it stands well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from acquisition import SettingError
from sonar_gym.control.fusion import StreetFilter
from sonar_gym.control.perception import Perception, Survey
from sonar_gym.parking.environment import MAX_RANGE, ODOMETRY_SPAN
from sonar_gym.parking.vehicle import CarSettings
from sonar_gym.sensing.mounts import LAYOUTS, Mount

Floats = NDArray[np.float64]
Observation = Mapping[str, NDArray[Any]]
NEEDED = ("left", "right front", "right rear", "rear", "front")
ARC_MARGIN = 1.05  # arcs are this much wider than the tightest turn, which leaves room to correct
LEAST_SPACE = 0.68  # m
ARCS_NEED = 0.69  # m of a space, by two arcs of this car; half of what is more is left behind it
REAR_ROOM = (0.03, 0.11)  # m, least and greatest
KERB_ROOM = 0.10  # m left beside it
CRUISE, CREEP = 0.30, 0.15  # m/s
END_OF_STREET = 0.35  # m; a wall so near ahead ends the search
END_READINGS = 5  # in a row that must say so
STOP_SHORT = 0.03  # m; nearest that anything may come at either end
STAND, LEG = 4, 12  # steps; a car that stands tells whether it is parked
LEAD = 0.03  # m; wheels take 0.2 s from one lock to the other
STIFFNESS, DAMPING = 16.0, 8.0  # 1/m^2, 1/m; errors off the path die out within 0.25 m
PERCEPTIONS: dict[str, type[Survey] | type[StreetFilter]] = {"survey": Survey, "fusion": StreetFilter}


def perceiving(given: str | Perception, mounts: Sequence[Mount], max_range: float) -> Perception:
    """Return a perception by name, or as it is."""
    if not isinstance(given, str):
        return given
    if given not in PERCEPTIONS:
        raise SettingError(f"perception {given!r}: no such kind; expected {', '.join(PERCEPTIONS)}")
    return PERCEPTIONS[given](mounts, max_range)


class Driver(Protocol):
    """Anything that drives from observations."""

    def reset(self) -> None:
        """Forget the last episode."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return an action in [-1, 1]^2."""
        ...


class Phase(Enum):
    """What the driver is at."""

    SEARCH = "search"
    ALIGN = "align"
    BACK = "back"
    FORTH = "forth"
    DONE = "done"


@dataclass(frozen=True)
class Plan:
    """Two equal arcs backwards, in the lane's frame.

    Attributes:
        ready: where they begin, x, y, heading, (3,).
        radius: of both, m.
        turn: of each, rad.
    """

    ready: Floats
    radius: float
    turn: float

    @classmethod
    def to(cls, goal: Floats, lane_y: float, radius: float) -> Plan:
        """Plan from the lane at `lane_y` to a goal x, y with the lane's heading."""
        turn = float(np.arccos(np.clip(1.0 - (lane_y - goal[1]) / (2.0 * radius), -1.0, 1.0)))
        return cls(np.array([goal[0] + 2.0 * radius * np.sin(turn), lane_y, 0.0]), radius, turn)

    @property
    def length(self) -> float:
        """Of the path, m."""
        return 2.0 * self.radius * self.turn

    def pose(self, gone: Floats) -> Floats:
        """Return x, y, heading after a way `gone` in m, (k,) -> (k, 3)."""
        first, turn, r = gone < self.radius * self.turn, self.turn, self.radius
        angle = np.where(first, gone / r, np.maximum(2.0 * turn - gone / r, 0.0))
        x1, y1 = self.ready[0] - r * np.sin(angle), self.ready[1] + r * (np.cos(angle) - 1.0)
        end_x, end_y = self.ready[0] - 2.0 * r * np.sin(turn), self.ready[1] - 2.0 * r * (1.0 - np.cos(turn))
        x2, y2 = end_x + r * np.sin(angle), end_y + r * (1.0 - np.cos(angle))
        return np.stack([np.where(first, x1, x2), np.where(first, y1, y2), angle], axis=-1)

    def curvature(self, gone: float) -> float:
        """Heading gained per metre of way backwards, 1/m."""
        return (1.0 if gone < self.radius * self.turn else -1.0) / self.radius

    def nearest(self, pose: Floats) -> float:
        """Return how far along the path a pose is, m."""
        gone = np.linspace(0.0, self.length, 200)
        poses = self.pose(gone)
        off = np.hypot(poses[:, 0] - pose[0], poses[:, 1] - pose[1]) + 0.1 * np.abs(poses[:, 2] - pose[2])
        return float(gone[np.argmin(off)])


class ParkingDriver:
    """Parks the car of SonarParking-v0.

    Args:
        mounts: the sonars, in the order of the observation; those called left, right front, right rear, front and
            rear are used.
        car: its measures.
        max_range: what a range of 1 in the observation stands for, m.
        perception: "survey" takes readings as they are, "fusion" weighs each by its credence; or one of your own.
    """

    def __init__(
        self,
        mounts: Sequence[Mount] = LAYOUTS["eight"],
        car: CarSettings | None = None,
        max_range: float = MAX_RANGE,
        perception: str | Perception = "survey",
    ) -> None:
        names = [mount.name for mount in mounts]
        missing = [name for name in NEEDED if name not in names]
        if missing:
            raise SettingError(f"ParkingDriver needs a sonar called {missing[0]!r}; the layout has {names}")
        self.car = car or CarSettings()
        self.max_range = max_range
        self.perception = perceiving(perception, mounts, max_range)
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.phase = Phase.SEARCH
        self.plan: Plan | None = None
        self.turns = 0
        self._blocked = 0
        self.perception.reset()

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return steering and speed wanted, as shares of the greatest."""
        ego = np.asarray(observation["ego"], dtype=np.float64)
        odometry = np.array([ego[4] * ODOMETRY_SPAN[0], ego[5] * ODOMETRY_SPAN[1], np.arctan2(ego[3], ego[2])])
        reading = np.asarray(observation["ranges"], dtype=np.float64) * self.max_range
        self.perception.look(odometry, reading, np.where(observation["echo"] > 0.5, observation["credence"], 0.0))
        steering, speed = self._decide(self.perception.pose)
        action = [steering / self.car.max_steering, speed / self.car.max_speed]
        return np.clip(np.array(action, dtype=np.float32), -1.0, 1.0)

    def _decide(self, pose: Floats) -> tuple[float, float]:
        if self.phase is Phase.SEARCH:
            return self._search(pose)
        if self.phase is Phase.ALIGN:
            return self._align(pose)
        if self.phase is Phase.BACK:
            return self._back(pose)
        return self._forth(pose) if self.phase is Phase.FORTH else (0.0, 0.0)

    # ---- search ------------------------------------------------------------------------------------------------------

    def _search(self, pose: Floats) -> tuple[float, float]:
        found = [space for space in self.perception.spaces() if space.length > LEAST_SPACE]
        self._blocked = self._blocked + 1 if self.perception.room("front") < END_OF_STREET else 0
        if found and np.isfinite(found[0].end):
            self.perception.choose(found[0])
            self.plan = self._planned(self.perception.pose[1])
            self.phase = Phase.ALIGN
        elif self._blocked >= END_READINGS:
            self.phase = Phase.DONE  # the street ends and no space was long enough
        return self._keep_lane(pose), CRUISE

    def _planned(self, lane_y: float) -> Plan:
        """Plan two arcs from the lane into the space, as it is known now."""
        space = self.perception.space
        assert space is not None
        room = float(np.clip(0.5 * (space.length - ARCS_NEED), *REAR_ROOM))
        goal = np.array([space.begin + self.car.rear_overhang + room, self._goal_y(), 0.0])
        return Plan.to(goal, lane_y, ARC_MARGIN * self.car.turning_radius)

    def _goal_y(self) -> float:
        return self.perception.kerb + KERB_ROOM + 0.5 * self.car.width

    def _keep_lane(self, pose: Floats) -> float:
        return float(np.arctan(self.car.wheelbase * (-STIFFNESS * pose[1] - DAMPING * pose[2])))

    # ---- park --------------------------------------------------------------------------------------------------------

    def _align(self, pose: Floats) -> tuple[float, float]:
        assert self.plan is not None
        self.plan = self._planned(pose[1])  # from the lane as it is really kept
        rest = self.plan.ready[0] - pose[0]
        if abs(rest) < 0.015:
            self.phase = Phase.BACK
            return 0.0, 0.0
        return self._keep_lane(pose) if rest > 0 else 0.0, float(np.clip(2.0 * rest, -CREEP, CRUISE))

    def _back(self, pose: Floats) -> tuple[float, float]:
        """Follow the arcs backwards; the way off them and the turn off theirs are steered away."""
        assert self.plan is not None
        self.plan = self._planned(float(self.plan.ready[1]))
        gone = self.plan.nearest(pose)
        rest = self.plan.length - gone
        if rest < 0.01 or (rest < 0.3 and self.perception.room("rear") < STOP_SHORT):
            self.phase = Phase.FORTH
            return 0.0, 0.0
        ref = self.plan.pose(np.array([gone]))[0]
        dx, dy = pose[0] - ref[0], pose[1] - ref[1]
        off, turned = np.cos(ref[2]) * dy - np.sin(ref[2]) * dx, pose[2] - ref[2]
        bend = self.plan.curvature(gone + LEAD) + STIFFNESS * off - DAMPING * turned
        return float(-np.arctan(self.car.wheelbase * bend)), -min(CREEP, 0.04 + rest)

    def _forth(self, pose: Floats) -> tuple[float, float]:
        """Stand; if that is not well parked, straighten forwards and backwards in what room there is; stand again."""
        leg, turn = divmod(self.turns, STAND + LEG)
        self.turns += 1
        forwards = leg % 2 == 0
        if turn < STAND or self.perception.room("front" if forwards else "rear") < STOP_SHORT + 0.02:
            return 0.0, 0.0
        bend = -STIFFNESS * (pose[1] - self._goal_y()) - DAMPING * pose[2]
        steering = float(np.arctan(self.car.wheelbase * bend))
        if forwards:
            return steering, 0.5 * CREEP
        back = STIFFNESS * (pose[1] - self._goal_y()) - DAMPING * pose[2]
        return float(-np.arctan(self.car.wheelbase * back)), -0.5 * CREEP


@dataclass(frozen=True)
class Episode:
    """What happened.

    Attributes:
        success: whether the car stood in the space.
        collision: whether it touched anything.
        steps: actions taken.
        score: sum of rewards.
        frames: pictures, each (height, width, 3) uint8; none where the environment draws none.
        readings: m, (steps + 1, sonars); the maximum range where there was no echo.
        echoes: 1 echo, 0 silence, -1 no answer, (steps + 1, sonars).
        credence: given the readings, (steps + 1, sonars).
        truths: m, (steps + 1, sonars).
    """

    success: bool
    collision: bool
    steps: int
    score: float
    frames: list[NDArray[np.uint8]] = field(repr=False)
    readings: Floats = field(repr=False)
    echoes: Floats = field(repr=False)
    credence: Floats = field(repr=False)
    truths: Floats = field(repr=False)


def run_episode(env: gymnasium.Env, driver: Driver, seed: int | None = None, every: int = 1) -> Episode:
    """Drive one episode of SonarParking-v0.

    Args:
        env: made by `gymnasium.make`; with `render_mode="rgb_array"` the pictures are kept.
        driver: that acts on observations.
        seed: of the street and of the sonars.
        every: draw at every so many steps, and at the end; 0 for no pictures.
    """
    every = every if env.render_mode == "rgb_array" else 0
    driver.reset()
    observation, info = env.reset(seed=seed)
    seen, truths, score, done = [observation], [info["distance"]], 0.0, False
    frames = [_picture(env)] if every else []
    while not done:
        observation, reward, terminated, truncated, info = env.step(driver.act(observation))
        seen.append(observation)
        truths.append(info["distance"])
        score, done = score + float(reward), terminated or truncated
        if every and (done or (len(seen) - 1) % every == 0):
            frames.append(_picture(env))
    return Episode(
        bool(info["is_success"]),
        bool(info["collision"]),
        len(seen) - 1,
        score,
        frames,
        np.array([o["ranges"] for o in seen], dtype=np.float64) * MAX_RANGE,
        np.array([o["echo"] for o in seen], dtype=np.float64),
        np.array([o["credence"] for o in seen], dtype=np.float64),
        np.array(truths),
    )


def _picture(env: gymnasium.Env) -> NDArray[np.uint8]:
    return np.asarray(env.render(), dtype=np.uint8)
