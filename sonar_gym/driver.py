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
from sonar_gym.mounts import LAYOUTS, Mount, in_world, mount_arrays
from sonar_gym.parking import MAX_RANGE, ODOMETRY_SPAN
from sonar_gym.survey import Space, clearance, lane_heading, spaces
from sonar_gym.vehicle import CarSettings

Floats = NDArray[np.float64]
Observation = Mapping[str, NDArray[Any]]
NEEDED = ("left", "right front", "right rear", "rear", "front")
ARC_MARGIN = 1.1  # arcs are this much wider than the tightest turn, which leaves room to correct
LEAST_SPACE = 0.68  # m; two arcs of this car need 0.65 m
REAR_ROOM = 0.11  # m left behind the parked car
KERB_ROOM = 0.07  # m left beside it
DEPTH = 0.35  # m from the boxes' faces to the kerb, where the kerb gave no echo
LEAST_CREDENCE = 0.2  # a reading less credible is treated as none
CRUISE, CREEP = 0.30, 0.15  # m/s
END_OF_STREET = 0.35  # m; a wall so near ahead ends the search
END_READINGS = 5  # in a row that must say so
STOP_SHORT = 0.05  # m; nearest that anything may come at either end
STIFFNESS, DAMPING = 16.0, 8.0  # 1/m^2, 1/m; errors off the path die out within 0.25 m


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
    """

    def __init__(
        self,
        mounts: Sequence[Mount] = LAYOUTS["eight"],
        car: CarSettings | None = None,
        max_range: float = MAX_RANGE,
    ) -> None:
        self.index = {mount.name: i for i, mount in enumerate(mounts)}
        missing = [name for name in NEEDED if name not in self.index]
        if missing:
            raise SettingError(f"ParkingDriver needs a sonar called {missing[0]!r}; the layout has {list(self.index)}")
        self.car = car or CarSettings()
        self.max_range = max_range
        self._poses, self._half = mount_arrays(mounts)
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.phase = Phase.SEARCH
        self.lane = 0.0  # heading of the lane in odometry's frame, rad
        self.plan: Plan | None = None
        self.space: Space | None = None
        self.kerb: float = -np.inf
        self.turns = 0
        self._track: list[Floats] = []
        self._heard: list[Floats] = []

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return steering and speed wanted, as shares of the greatest."""
        ego = np.asarray(observation["ego"], dtype=np.float64)
        odometry = np.array([ego[4] * ODOMETRY_SPAN[0], ego[5] * ODOMETRY_SPAN[1], np.arctan2(ego[3], ego[2])])
        trusted = (observation["echo"] > 0.5) & (observation["credence"] >= LEAST_CREDENCE)
        readings = np.where(trusted, observation["ranges"] * self.max_range, self.max_range).astype(np.float64)
        steering, speed = self._decide(odometry, readings)
        action = [steering / self.car.max_steering, speed / self.car.max_speed]
        return np.clip(np.array(action, dtype=np.float32), -1.0, 1.0)

    def _decide(self, odometry: Floats, readings: Floats) -> tuple[float, float]:
        if self.phase is Phase.SEARCH:
            self._survey(odometry, readings)
        pose = self.in_lane(odometry)
        if self.phase is Phase.SEARCH:
            return self._search(pose)
        if self.phase is Phase.ALIGN:
            return self._align(pose)
        if self.phase is Phase.BACK:
            return self._back(pose, readings)
        return self._forth(pose, readings) if self.phase is Phase.FORTH else (0.0, 0.0)

    def in_lane(self, pose: Floats) -> Floats:
        """Return poses of odometry's frame in the lane's, (..., 3)."""
        c, s = np.cos(self.lane), np.sin(self.lane)
        x, y, heading = pose[..., 0], pose[..., 1], pose[..., 2]
        return np.stack([c * x + s * y, c * y - s * x, heading - self.lane], axis=-1)

    # ---- search ------------------------------------------------------------------------------------------------------

    def _survey(self, odometry: Floats, readings: Floats) -> None:
        """Keep where every sonar was and what it read, and fit the lane to the wall on the left."""
        self._track.append(in_world(self._poses, odometry))
        self._heard.append(readings)
        left = self.index["left"]
        track, heard = np.array(self._track)[:, left], np.array(self._heard)[:, left]
        echo = heard < self.max_range
        self.lane = lane_heading(track[echo, 0], track[echo, 1], heard[echo])

    def _profile(self, name: str) -> tuple[Floats, Floats]:
        """Return where a sonar was in the lane's frame and what it read: (n, 3), (n,)."""
        i = self.index[name]
        return self.in_lane(np.array(self._track)[:, i]), np.array(self._heard)[:, i]

    def _search(self, pose: Floats) -> tuple[float, float]:
        along, heard = self._profile("right front")
        found = [s for s in spaces(along[:, 0], heard, self._half[self.index["right front"]]) if s.length > LEAST_SPACE]
        if found and np.isfinite(found[0].end):
            self._choose(found[0], pose)
        elif np.all(self._profile("front")[1][-END_READINGS:] < END_OF_STREET) and len(self._track) > END_READINGS:
            self.phase = Phase.DONE  # the street ends and no space was long enough
        return self._keep_lane(pose), CRUISE

    def _choose(self, space: Space, pose: Floats) -> None:
        """Plan two arcs into a space; its beginning is the mean of what both sonars on the right say."""
        rear, heard = self._profile("right rear")
        again = spaces(rear[:, 0], heard, self._half[self.index["right rear"]])
        close = [s.begin for s in again if abs(s.begin - space.begin) < 0.1]
        self.space = Space(float(np.mean([space.begin, *close])), space.end)
        self.kerb = self._kerb_y(self.space)
        goal = np.array([self.space.begin + self.car.rear_overhang + REAR_ROOM, self._goal_y(), 0.0])
        self.plan = Plan.to(goal, pose[1], ARC_MARGIN * self.car.turning_radius)
        self.phase = Phase.ALIGN

    def _goal_y(self) -> float:
        return self.kerb + KERB_ROOM + 0.5 * self.car.width

    def _kerb_y(self, space: Space) -> float:
        """Return where the kerb lies: the sonars on the right read it from the middle of the space."""
        face, kerb = [], []
        for name in ("right front", "right rear"):
            where, heard = self._profile(name)
            inside = (where[:, 0] > space.begin + 0.3) & (where[:, 0] < space.end - 0.3) & (heard < 1.0)
            kerb.extend(where[inside, 1] - heard[inside])
            face.append(float(np.median(where[:, 1])) - clearance(heard))
        expected = float(np.mean(face)) - DEPTH
        seen = [y for y in kerb if abs(y - expected) < 0.08]
        return float(np.median(seen)) if seen else expected

    def _keep_lane(self, pose: Floats) -> float:
        return float(np.arctan(self.car.wheelbase * (-STIFFNESS * pose[1] - DAMPING * pose[2])))

    # ---- park --------------------------------------------------------------------------------------------------------

    def _align(self, pose: Floats) -> tuple[float, float]:
        assert self.plan is not None
        rest = self.plan.ready[0] - pose[0]
        if abs(rest) < 0.015:
            goal = self.plan.pose(np.array([self.plan.length]))[0]
            self.plan = Plan.to(goal, pose[1], self.plan.radius)  # from the lane as it was really kept
            self.phase = Phase.BACK
            return 0.0, 0.0
        return self._keep_lane(pose) if rest > 0 else 0.0, float(np.clip(2.0 * rest, -CREEP, CRUISE))

    def _back(self, pose: Floats, readings: Floats) -> tuple[float, float]:
        """Follow the arcs backwards; the way off them and the turn off theirs are steered away."""
        assert self.plan is not None
        gone = self.plan.nearest(pose)
        rest = self.plan.length - gone
        if rest < 0.01 or (rest < 0.3 and readings[self.index["rear"]] < STOP_SHORT):
            self.phase = Phase.FORTH
            return 0.0, 0.0
        ref = self.plan.pose(np.array([gone]))[0]
        dx, dy = pose[0] - ref[0], pose[1] - ref[1]
        off, turned = np.cos(ref[2]) * dy - np.sin(ref[2]) * dx, pose[2] - ref[2]
        bend = self.plan.curvature(gone) + STIFFNESS * off - DAMPING * turned
        return float(-np.arctan(self.car.wheelbase * bend)), -min(CREEP, 0.04 + rest)

    def _forth(self, pose: Floats, readings: Floats) -> tuple[float, float]:
        """Stand; if that is not well parked, straighten forwards and backwards in what room there is."""
        self.turns += 1
        forwards = (self.turns // 12) % 2 == 1
        near = readings[self.index["front" if forwards else "rear"]] < STOP_SHORT + 0.02
        if self.turns < 12 or near:
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
