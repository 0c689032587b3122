"""Where the car is and how the street lies, from odometry and all sonars, each reading weighed by its credence.

An extended Kalman filter over the car's pose, the error of its steering, and the lines of the street. A reading is
either right, about what the filter expects, or anything at all: its credence is the prior probability of the first, and
its posterior weighs the update (probabilistic data association: Bar-Shalom and Tse 1975, "Tracking in a cluttered
environment with probabilistic data association"). Why it is written here: docs/decisions.

The frame is the street's: x along the boxes from where the car began, y to the left.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_gym.control.perception import JUMP, LEAST_CREDENCE, Space, clearance, runs
from sonar_gym.control.street_inference import (
    EDGES,
    FACE,
    HEADING,
    KERB,
    PULL,
    X,
    Y,
    edge_log_likelihood,
    heard_all,
    opened,
)
from sonar_gym.sensing import kernels
from sonar_gym.sensing.mounts import Mount, in_world, mount_arrays

Floats = NDArray[np.float64]
RECENT = 3  # readings of which one may be wrong
AT_START = 1e-3  # m; the frame is where the car stands first
WALL_SIDE, BOX_SIDE = "left", "right front"
BOX_SIDES = ("right front", "right rear")
REACH, GRID = 0.2, 81  # m to either side of where an edge was proposed, and places there
NEAR_EDGE = 0.6  # m; sonars farther from an edge than that say nothing of it
EDGE_FLOOR = 0.02  # m
DOUBTFUL = (0.55, 0.90)  # m; spaces first proposed as long as this may be long enough, or not


@dataclass(frozen=True)
class FusionSettings:
    """What is expected before anything is heard; spreads are standard deviations.

    Attributes:
        start_spread: of the start's heading to the street, rad.
        pull: of the heading that odometry gains on a straight way, rad/m.
        slip: of the way gone, m per square root of a metre.
        wander: of odometry's heading, rad per square root of a metre.
        wall: on the left, mean and spread, m.
        face: of the boxes, likewise.
        depth: from the boxes' faces to the kerb, likewise.
        edge: spread of the ends of a space as first proposed, m.
        right: spread of a right reading as a share of it: credence counts those within 10 %, which is twice this.
        floor: least spread of a reading, m.
        hazard: how often boxes begin or end, 1/m.
        doubt: least probability that a reading is wrong.
    """

    start_spread: float = np.radians(3.0)
    pull: float = np.radians(2.0)
    slip: float = 0.02
    wander: float = np.radians(0.7)
    wall: tuple[float, float] = (0.75, 0.15)
    face: tuple[float, float] = (-0.32, 0.05)
    depth: tuple[float, float] = (0.35, 0.04)
    edge: float = 0.08
    right: float = 0.05
    floor: float = 0.01
    hazard: float = 2.0
    doubt: float = 0.02


@dataclass(frozen=True)
class Look:
    """What came in at one step.

    Attributes:
        moved: by odometry since the last, in the last one's frame: m, m, rad, (3,).
        reading: m, (n,).
        credence: of each, (n,); 0 where there was no echo.
    """

    moved: Floats
    reading: Floats
    credence: Floats


class StreetFilter:
    """Follows a car along a street, and into a space once it is told which.

    Args:
        mounts: the sonars, in the order of the observation.
        max_range: what the sonars can read, m.
        settings: what is expected beforehand.
    """

    def __init__(self, mounts: Sequence[Mount], max_range: float, settings: FusionSettings | None = None) -> None:
        self.index = {mount.name: i for i, mount in enumerate(mounts)}
        self.max_range = max_range
        self.settings = settings or FusionSettings()
        self._tolerance = self.settings.right, self.settings.floor
        self._poses, self._half = mount_arrays(mounts)
        self._used = np.arange(len(mounts)) == self.index[WALL_SIDE]  # until the boxes are known
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.state, self.spread = self._prior([])
        self._free = np.ones(len(self.state))
        self._beside: int | None = None  # which edge the space begins at
        self._last: Floats | None = None
        self._looks: list[Look] = []
        self._track: list[Floats] = []
        self._recent: deque[Floats] = deque(maxlen=RECENT)
        self._known: dict[Space, Space] = {}  # spaces as first proposed, and as measured

    def _prior(self, edges: Sequence[float]) -> tuple[Floats, Floats]:
        """Return mean and covariance at the start, with what edges of boxes are known."""
        s = self.settings
        mean = [0.0, 0.0, 0.0, 0.0, s.wall[0], s.face[0], s.face[0] - s.depth[0], *edges]
        kerb = float(np.hypot(s.face[1], s.depth[1]))
        own = [AT_START, AT_START, s.start_spread, s.pull, s.wall[1], s.face[1], kerb]
        spread = np.diag(np.square([*own, *[s.edge] * len(edges)]))
        spread[FACE, KERB] = spread[KERB, FACE] = s.face[1] ** 2
        return np.array(mean), spread

    @property
    def pose(self) -> Floats:
        """The car's in the street's frame: m, m, rad, (3,)."""
        return self.state[:3].copy()

    # ---- step by step ------------------------------------------------------------------------------------------------

    def look(self, odometry: Floats, reading: Floats, credence: Floats) -> None:
        """Take in a step.

        Args:
            odometry: pose since the start, m, m, rad, (3,).
            reading: m, (n,); whatever where there was no echo.
            credence: given the readings, (n,); 0 where there was no echo.
        """
        last = odometry if self._last is None else self._last
        moved = np.array([*kernels.to_frame(odometry[0], odometry[1], last), odometry[2] - last[2]])
        moved[2] = (moved[2] + np.pi) % (2.0 * np.pi) - np.pi
        self._last = odometry.copy()
        self._recent.append(np.where(credence > 0.0, reading, self.max_range))
        look = Look(moved, reading, np.minimum(credence, 1.0 - self.settings.doubt))
        self._take(look)
        if self._beside is None:
            self._looks.append(look)
            self._track.append(self.state)

    def _take(self, look: Look) -> None:
        self._move(look.moved)
        credence = np.where(self._used, look.credence, 0.0) if self._beside is None else look.credence
        sonars = self._poses, self._half, look.reading, credence
        self.state, self.spread = heard_all(
            self.state, self.spread, *sonars, self._free, self._tolerance, self.max_range
        )

    def _move(self, moved: Floats) -> None:
        """Go on by odometry, less the pull that it is thought to have; the way backwards pulls the other way."""
        before, way = self.state.copy(), float(moved[0])
        slopes = np.eye(len(before))
        c, s = np.cos(before[HEADING]), np.sin(before[HEADING])
        self.state[X] += c * moved[0] - s * moved[1]
        self.state[Y] += s * moved[0] + c * moved[1]
        self.state[HEADING] += moved[2] - before[PULL] * way
        slopes[X, HEADING], slopes[Y, HEADING], slopes[HEADING, PULL] = -s * way, c * way, -way
        drift = np.zeros(len(before))
        drift[X] = self.settings.slip**2 * abs(way)
        drift[HEADING] = self.settings.wander**2 * abs(way)
        self.spread = slopes @ self.spread @ slopes.T + np.diag(drift)

    # ---- spaces ------------------------------------------------------------------------------------------------------

    def edges(self) -> list[float]:
        """Return where boxes began and ended by turns so far, as the foremost sonar on the right saw, x in m."""
        i = self.index[BOX_SIDE]
        along = np.array([in_world(self._poses[i : i + 1], state[:3])[0, 0] for state in self._track])
        reading = np.array([look.reading[i] for look in self._looks])
        credence = np.array([look.credence[i] for look in self._looks])
        threshold = clearance(reading[credence > LEAST_CREDENCE]) + JUMP
        step = np.abs(np.diff(along, prepend=along[0]))
        chance = opened(reading > threshold, credence, step, 1.0 - threshold / self.max_range, self.settings.hazard)
        corner = threshold * np.sin(self._half[i])
        turns = runs(chance > 0.5)
        turns = turns[1:] if turns[0][2] else turns  # what is open before the first box is no space
        out = [along[begin] + (-corner if far else corner) for begin, _, far in turns]
        return [along[0] - corner, *out[1:]] if turns and turns[0][0] == 0 else out

    def spaces(self) -> list[Space]:
        """Return the spaces passed so far, the last perhaps without its end; those that may do are measured well."""
        edges = [*self.edges(), np.inf]
        coarse = [Space(begin, end) for begin, end in zip(edges[1:-1:2], edges[2::2], strict=True)]
        return [self._measured(space) if DOUBTFUL[0] < space.length < DOUBTFUL[1] else space for space in coarse]

    def _measured(self, space: Space) -> Space:
        """Return a space by all that was heard of it; its ends as first proposed tell whether that is known yet."""
        if space not in self._known:
            kept = self.state, self.spread, self._free
            self.choose(space)
            assert self.space is not None
            self._known[space] = self.space
            self._beside = None
            self.state, self.spread, self._free = kept
        return self._known[space]

    def choose(self, space: Space) -> None:
        """Begin anew with all edges known, and take in all that was heard so far with them in mind."""
        edges = np.array(self.edges())
        first = int(np.argmin(np.abs(edges - space.begin)))
        edges = edges[: first + 2]
        self._beside = EDGES + first
        self.state, self.spread = self._prior(edges.tolist())
        self._free = np.ones(len(self.state))
        self._free[[X, *range(EDGES, len(self.state))]] = 0.0  # what edges are seen at says nothing of the way yet
        track = [self._taken(look) for look in self._looks]
        self._free[:] = 1.0
        self.spread[X], self.spread[:, X] = 0.0, 0.0  # from here on the frame is where the car is now
        for k in range(EDGES, len(self.state)):
            self._place(k, track)

    def _taken(self, look: Look) -> Floats:
        self._take(look)
        return self.state[:3].copy()

    def _place(self, k: int, track: list[Floats]) -> None:
        """Find an edge from all readings of the sonars on the right: mean and spread of its posterior on a grid."""
        at = self.state[k] + np.linspace(-REACH, REACH, GRID)
        used = [self.index[name] for name in BOX_SIDES]
        log = np.zeros(GRID)
        for pose, look in zip(track, self._looks, strict=True):
            poses = in_world(self._poses[used], pose)
            near = np.abs(poses[:, 0] - self.state[k]) < NEAR_EDGE
            if near.any():
                heard = self._half[used][near], look.reading[used][near], look.credence[used][near]
                log += edge_log_likelihood(self.state, k, at, poses[near], *heard, self._tolerance, self.max_range)
        share = np.exp(log - log.max())
        share /= share.sum()
        mean = float(share @ at)
        self.state[k] = mean
        self.spread[k], self.spread[:, k] = 0.0, 0.0
        self.spread[k, k] = float(share @ (at - mean) ** 2) + EDGE_FLOOR**2

    # ---- what the driver asks ----------------------------------------------------------------------------------------

    @property
    def kerb(self) -> float:
        """Where the kerb lies, y in m."""
        return float(self.state[KERB])

    @property
    def space(self) -> Space | None:
        """The space that was chosen, as it is known by now."""
        if self._beside is None:
            return None
        return Space(float(self.state[self._beside]), float(self.state[self._beside + 1]))

    def room(self, name: str) -> float:
        """Return how far a sonar can see, m: the median of its last readings, silence being its range."""
        return float(np.median([look[self.index[name]] for look in self._recent]))
