"""The scripted parking controller, and `run_episode`, which drives an episode with any controller.

The controller follows the lane by odometry and the far wall, measures the spaces between the boxes with the sonars on
its right, stops beside the first space that is long enough, reverses into it along two arcs, and corrects its pose by
short moves until the episode ends.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from acquisition import SettingError
from acquisition.arguments import checked
from acquisition.arrays import Floats, Ints, Singles
from acquisition.limits import SEEDS, Limit, PositiveMetres, shown
from sonar_gym.checks import check_observation
from sonar_gym.control.fusion import StreetFilter
from sonar_gym.control.memory import EGO
from sonar_gym.control.perception import Perception, RawPerception
from sonar_gym.parking.environment import MAX_RANGE, ODOMETRY_SPAN
from sonar_gym.sensing.mounts import LAYOUTS, Mount
from sonar_gym.street.vehicle import CarSettings

Observation = Mapping[str, NDArray[Any]]
NEEDED = ("left", "right front", "right rear", "rear", "front")
ARC_MARGIN = 1.05  # ratio of the arcs' radius to the least turning radius; leaves room for corrections
MIN_SPACE = 0.68  # m
ARC_SPACE = 0.69  # m; length that two arcs of this car need; half of any excess is left behind the car
REAR_CLEARANCE = (0.03, 0.11)  # m, limits
KERB_CLEARANCE = 0.10  # m
CRUISE_SPEED, MANOEUVRE_SPEED = 0.30, 0.15  # m/s
STREET_END_RANGE = 0.35  # m; a front range below it, for STREET_END_COUNT steps in a row, ends the search
STREET_END_COUNT = 5
MIN_CLEARANCE = 0.03  # m, at either end of the car
WAIT_STEPS, MOVE_STEPS = 4, 12  # the environment detects a parked car while it stands
EVERY = Limit(0, 1_000_000)
STEERING_LEAD = 0.03  # m; compensates the 0.2 s that the wheels take from one lock to the other
STIFFNESS, DAMPING = 16.0, 8.0  # 1/m^2, 1/m; errors off the path decay within 0.25 m
PERCEPTIONS: dict[str, type[RawPerception] | type[StreetFilter]] = {"survey": RawPerception, "fusion": StreetFilter}


def make_perception(given: str | Perception, mounts: Sequence[Mount], max_range: float) -> Perception:
    """Return a perception by name; return an object unchanged."""
    if not isinstance(given, str):
        if not all(hasattr(given, name) for name in ("update", "reset", "spaces", "clearance")):
            known = ", ".join(PERCEPTIONS)
            raise SettingError(f"perception: expected one of {known}, or an object like these, got {shown(given)}")
        return given
    if given not in PERCEPTIONS:
        raise SettingError(f"perception {given!r}: no such kind; expected {', '.join(PERCEPTIONS)}")
    return PERCEPTIONS[given](mounts, max_range)


@runtime_checkable
class Controller(Protocol):
    """Any controller of the car that acts on observations."""

    def reset(self) -> None:
        """Begin an episode."""

    def act(self, observation: Observation) -> Singles:
        """Return an action in [-1, 1]^2."""
        ...


class Phase(Enum):
    """Phase of the parking manoeuvre."""

    SEARCH = "search"
    ALIGN = "align"
    REVERSE = "reverse"
    CORRECT = "correct"
    GIVE_UP = "give up"


@dataclass(frozen=True)
class ReversePath:
    """Path of two equal arcs of opposite curvature, driven backwards, in the lane frame.

    Attributes:
        start: x, y, heading at the beginning, (3,).
        radius: radius of the arcs, m.
        turn: angle of each arc, rad.
    """

    start: Floats
    radius: float
    turn: float

    @classmethod
    def to(cls, goal: Floats, lane_y: float, radius: float) -> ReversePath:
        """Return the path from the lane at `lane_y` to a goal x, y with the heading of the lane."""
        turn = float(np.arccos(np.clip(1.0 - (lane_y - goal[1]) / (2.0 * radius), -1.0, 1.0)))
        return cls(np.array([goal[0] + 2.0 * radius * np.sin(turn), lane_y, 0.0]), radius, turn)

    @property
    def length(self) -> float:
        """Arc length, m."""
        return 2.0 * self.radius * self.turn

    def pose(self, travelled: Floats) -> Floats:
        """Return x, y, heading at arc lengths in m, (k,) -> (k, 3)."""
        first, turn, r = travelled < self.radius * self.turn, self.turn, self.radius
        angle = np.where(first, travelled / r, np.maximum(2.0 * turn - travelled / r, 0.0))
        x1, y1 = self.start[0] - r * np.sin(angle), self.start[1] + r * (np.cos(angle) - 1.0)
        end_x, end_y = self.start[0] - 2.0 * r * np.sin(turn), self.start[1] - 2.0 * r * (1.0 - np.cos(turn))
        x2, y2 = end_x + r * np.sin(angle), end_y + r * (1.0 - np.cos(angle))
        return np.stack([np.where(first, x1, x2), np.where(first, y1, y2), angle], axis=-1)

    def curvature(self, travelled: float) -> float:
        """Return the change of heading per metre driven backwards at an arc length, 1/m."""
        return (1.0 if travelled < self.radius * self.turn else -1.0) / self.radius

    def project(self, pose: Floats) -> float:
        """Return the arc length of the point of the path nearest to a pose, m."""
        travelled = np.linspace(0.0, self.length, 200)
        poses = self.pose(travelled)
        off = np.hypot(poses[:, 0] - pose[0], poses[:, 1] - pose[1]) + 0.1 * np.abs(poses[:, 2] - pose[2])
        return float(travelled[np.argmin(off)])


class ParkingDriver:
    """Scripted controller that parks the car of SonarParking-v0.

    Args:
        mounts: sonars in the order of the observation; those named left, right front, right rear, front and rear are
            used.
        car: dimensions and limits of the car.
        max_range: distance of a range of 1 in the observation, m.
        perception: "survey" takes readings at face value, "fusion" weights each by its credence; or an object with the
            methods of `Perception`.
    """

    @checked
    def __init__(
        self,
        mounts: Sequence[Mount] = LAYOUTS["eight"],
        car: CarSettings | None = None,
        max_range: PositiveMetres = MAX_RANGE,
        perception: str | Perception = "survey",
    ) -> None:
        names = [mount.name for mount in mounts]
        missing = [name for name in NEEDED if name not in names]
        if missing:
            raise SettingError(f"ParkingDriver needs a sonar named {missing[0]!r}; the layout has {names}")
        self.car = car or CarSettings()
        self._shapes = {"ego": (EGO,), **dict.fromkeys(("ranges", "echo", "credence"), (len(names),))}
        self.max_range = max_range
        self.perception = make_perception(perception, mounts, max_range)
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self.phase = Phase.SEARCH
        self.path: ReversePath | None = None
        self._correction_steps = 0
        self._end_count = 0
        self.perception.reset()

    def act(self, observation: Observation) -> Singles:
        """Return the steering and speed setpoints as fractions of their maxima, (2,)."""
        check_observation(observation, self._shapes)
        ego = np.asarray(observation["ego"], dtype=np.float64)
        odometry = np.array([ego[4] * ODOMETRY_SPAN[0], ego[5] * ODOMETRY_SPAN[1], np.arctan2(ego[3], ego[2])])
        reading = np.asarray(observation["ranges"], dtype=np.float64) * self.max_range
        self.perception.update(odometry, reading, np.where(observation["echo"] > 0.5, observation["credence"], 0.0))
        steering, speed = self._setpoints(self.perception.pose)
        action = [steering / self.car.max_steering, speed / self.car.max_speed]
        return np.clip(np.array(action, dtype=np.float32), -1.0, 1.0)

    def _setpoints(self, pose: Floats) -> tuple[float, float]:
        """Return steering, rad, and speed, m/s."""
        if self.phase is Phase.SEARCH:
            return self._search(pose)
        if self.phase is Phase.ALIGN:
            return self._align(pose)
        if self.phase is Phase.REVERSE:
            return self._reverse(pose)
        return self._correct(pose) if self.phase is Phase.CORRECT else (0.0, 0.0)

    # ---- search ------------------------------------------------------------------------------------------------------

    def _search(self, pose: Floats) -> tuple[float, float]:
        found = [space for space in self.perception.spaces() if space.length > MIN_SPACE]
        self._end_count = self._end_count + 1 if self.perception.clearance("front") < STREET_END_RANGE else 0
        if found and np.isfinite(found[0].end):
            self.perception.select(found[0])
            self.path = self._plan(self.perception.pose[1])
            self.phase = Phase.ALIGN
        elif self._end_count >= STREET_END_COUNT:
            self.phase = Phase.GIVE_UP  # end of the street without a space that is long enough
        return self._keep_lane(pose), CRUISE_SPEED

    def _plan(self, lane_y: float) -> ReversePath:
        """Return the path from the lane into the selected space, by its current estimate."""
        space = self.perception.space
        assert space is not None
        clearance = float(np.clip(0.5 * (space.length - ARC_SPACE), *REAR_CLEARANCE))
        goal = np.array([space.begin + self.car.rear_overhang + clearance, self._goal_y(), 0.0])
        return ReversePath.to(goal, lane_y, ARC_MARGIN * self.car.turning_radius)

    def _goal_y(self) -> float:
        return self.perception.kerb + KERB_CLEARANCE + 0.5 * self.car.width

    def _keep_lane(self, pose: Floats) -> float:
        return float(np.arctan(self.car.wheelbase * (-STIFFNESS * pose[1] - DAMPING * pose[2])))

    # ---- park --------------------------------------------------------------------------------------------------------

    def _align(self, pose: Floats) -> tuple[float, float]:
        assert self.path is not None
        self.path = self._plan(pose[1])
        remaining = self.path.start[0] - pose[0]
        if abs(remaining) < 0.015:
            self.phase = Phase.REVERSE
            return 0.0, 0.0
        speed = float(np.clip(2.0 * remaining, -MANOEUVRE_SPEED, CRUISE_SPEED))
        return self._keep_lane(pose) if remaining > 0 else 0.0, speed

    def _reverse(self, pose: Floats) -> tuple[float, float]:
        """Follow the path backwards, with feedback on the lateral and the heading error."""
        assert self.path is not None
        self.path = self._plan(float(self.path.start[1]))
        travelled = self.path.project(pose)
        remaining = self.path.length - travelled
        if remaining < 0.01 or (remaining < 0.3 and self.perception.clearance("rear") < MIN_CLEARANCE):
            self.phase = Phase.CORRECT
            return 0.0, 0.0
        ref = self.path.pose(np.array([travelled]))[0]
        dx, dy = pose[0] - ref[0], pose[1] - ref[1]
        lateral, turned = np.cos(ref[2]) * dy - np.sin(ref[2]) * dx, pose[2] - ref[2]
        curvature = self.path.curvature(travelled + STEERING_LEAD) + STIFFNESS * lateral - DAMPING * turned
        return float(-np.arctan(self.car.wheelbase * curvature)), -min(MANOEUVRE_SPEED, 0.04 + remaining)

    def _correct(self, pose: Floats) -> tuple[float, float]:
        """Alternate between standing and moving, forwards and backwards in turn, to reduce the error of the pose."""
        leg, step = divmod(self._correction_steps, WAIT_STEPS + MOVE_STEPS)
        self._correction_steps += 1
        forwards = leg % 2 == 0
        clearance = self.perception.clearance("front" if forwards else "rear")
        if step < WAIT_STEPS or clearance < MIN_CLEARANCE + 0.02:
            return 0.0, 0.0
        if forwards:
            curvature = -STIFFNESS * (pose[1] - self._goal_y()) - DAMPING * pose[2]
            return float(np.arctan(self.car.wheelbase * curvature)), 0.5 * MANOEUVRE_SPEED
        curvature = STIFFNESS * (pose[1] - self._goal_y()) - DAMPING * pose[2]
        return float(-np.arctan(self.car.wheelbase * curvature)), -0.5 * MANOEUVRE_SPEED


@dataclass(frozen=True)
class Episode:
    """Record of an episode.

    Attributes:
        success: whether the car parked.
        collision: whether the car collided.
        steps: number of actions.
        score: sum of rewards.
        frames: images, each (height, width, 3) uint8; empty if the environment does not render.
        readings: m, (steps + 1, sonars); the maximum range without an echo.
        echoes: 1 echo, 0 no echo, -1 no answer, (steps + 1, sonars).
        credence: given the readings, (steps + 1, sonars).
        truths: true distances, m, (steps + 1, sonars).
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


@checked
def run_episode(
    env: gymnasium.Env, driver: Controller, seed: Annotated[int, SEEDS] | None = None, every: Annotated[int, EVERY] = 1
) -> Episode:
    """Drive one episode of SonarParking-v0.

    Args:
        env: environment from `gymnasium.make`; with `render_mode="rgb_array"` images are recorded.
        driver: controller of the car.
        seed: seed of the environment.
        every: record an image every `every` steps, and at the end; 0: no images.
    """
    every = every if env.render_mode == "rgb_array" else 0
    driver.reset()
    observation, info = env.reset(seed=seed)
    observations, truths, score, done = [observation], [info["distance"]], 0.0, False
    frames = [_image(env)] if every else []
    while not done:
        observation, reward, terminated, truncated, info = env.step(driver.act(observation))
        observations.append(observation)
        truths.append(info["distance"])
        score, done = score + float(reward), terminated or truncated
        if every and (done or (len(observations) - 1) % every == 0):
            frames.append(_image(env))
    return Episode(
        bool(info["is_success"]),
        bool(info["collision"]),
        len(observations) - 1,
        score,
        frames,
        np.array([o["ranges"] for o in observations], dtype=np.float64) * MAX_RANGE,
        np.array([o["echo"] for o in observations], dtype=np.float64),
        np.array([o["credence"] for o in observations], dtype=np.float64),
        np.array(truths),
    )


def drive_by_script(count: int) -> Callable[[Observation, Ints], Floats]:
    """Return scripted drivers of n cars: `act(observation, begun)`, with the numbers of cars that begin an episode."""
    drivers = [ParkingDriver() for _ in range(count)]

    def act(observation: Observation, begun: Ints) -> Floats:
        for i in begun:
            drivers[i].reset()
        own = ({name: value[i] for name, value in observation.items()} for i in range(count))
        return np.array([driver.act(one) for driver, one in zip(drivers, own, strict=True)], dtype=np.float64)

    return act


def _image(env: gymnasium.Env) -> NDArray[np.uint8]:
    return np.asarray(env.render(), dtype=np.uint8)
