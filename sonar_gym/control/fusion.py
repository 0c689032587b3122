"""Perception by an extended Kalman filter over the car's pose, the bias of its odometry, and the lines of the street.

A reading is either correct, close to its expected value, or arbitrary. Its credence is the prior probability of the
first case, and the posterior probability weights the update (probabilistic data association: Bar-Shalom and Tse 1975,
"Tracking in a cluttered environment with probabilistic data association"). docs/explanation/decisions gives the reasons
for it.

The frame is that of the street: x along the boxes from the initial position of the car, y to the left.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Floats
from sonar_gym.control.perception import JUMP, MIN_CREDENCE, ParkingSpace, box_distance, find_runs
from sonar_gym.control.street_inference import (
    BIAS,
    EDGES,
    FACE,
    HEADING,
    KERB,
    X,
    Y,
    edge_log_likelihood,
    space_probability,
    update_all,
)
from sonar_gym.sensing import kernels
from sonar_gym.sensing.mounts import Mount, in_world, mount_arrays

MEDIAN_COUNT = 3  # readings whose median gives the clearance; one of them may be an outlier
START_SD = 1e-3  # m; the origin is the initial position
WALL_SONAR, BOX_SONAR = "left", "right front"
BOX_SONARS = ("right front", "right rear")
EDGE_SEARCH, EDGE_POINTS = 0.2, 81  # half width of the search for an edge, m, and its number of grid points
EDGE_NEIGHBOURHOOD = 0.6  # m; readings of sonars farther from an edge do not constrain it
EDGE_SD_FLOOR = 0.02  # m
REFINE_LENGTHS = (0.55, 0.90)  # m; spaces with a first estimate in this interval are measured again


@dataclass(frozen=True)
class FusionSettings:
    """Prior and noise of the filter. `sd` stands for standard deviation.

    Attributes:
        heading_sd: initial heading relative to the street, rad.
        bias_sd: curvature bias of the odometry (heading gained on a straight path), rad/m.
        slip_sd: distance travelled, m per square root of a metre.
        heading_walk_sd: heading of the odometry, rad per square root of a metre.
        wall: y of the wall on the left, mean and sd, m.
        face: y of the faces of the boxes, mean and sd, m.
        depth: distance from the faces to the kerb, mean and sd, m.
        edge_sd: first estimate of the ends of a space, m.
        relative_sd: correct reading, as a fraction of the range. Credence counts readings within 10 %, that is 2 sd.
        sd_floor: least sd of a reading, m.
        edge_rate: mean number of ends of boxes per metre, 1/m.
        min_error: least probability that a reading is wrong.
    """

    heading_sd: float = np.radians(3.0)
    bias_sd: float = np.radians(2.0)
    slip_sd: float = 0.02
    heading_walk_sd: float = np.radians(0.7)
    wall: tuple[float, float] = (0.75, 0.15)
    face: tuple[float, float] = (-0.32, 0.05)
    depth: tuple[float, float] = (0.35, 0.04)
    edge_sd: float = 0.08
    relative_sd: float = 0.05
    sd_floor: float = 0.01
    edge_rate: float = 2.0
    min_error: float = 0.02


@dataclass(frozen=True)
class FilterInput:
    """Input of the filter at one step.

    Attributes:
        motion: motion by odometry since the last step, in the frame of the last pose: m, m, rad, (3,).
        reading: m, (n,).
        credence: (n,); 0 without an echo.
    """

    motion: Floats
    reading: Floats
    credence: Floats


class StreetFilter:
    """Filter that tracks the car along the street, and into a space once it has been selected.

    Args:
        mounts: sonars in the order of the observation.
        max_range: maximum range of the sonars, m.
        settings: prior and noise.
    """

    def __init__(self, mounts: Sequence[Mount], max_range: float, settings: FusionSettings | None = None) -> None:
        self.index = {mount.name: i for i, mount in enumerate(mounts)}
        self.max_range = max_range
        self.settings = settings or FusionSettings()
        self._tolerance = self.settings.relative_sd, self.settings.sd_floor
        self._poses, self._half = mount_arrays(mounts)
        self._used = np.arange(len(mounts)) == self.index[WALL_SONAR]  # while the boxes are unknown
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self.state, self.covariance = self._prior([])
        self._free = np.ones(len(self.state))
        self._space_edge: int | None = None  # index in the state of the edge at which the selected space begins
        self._last: Floats | None = None
        self._inputs: list[FilterInput] = []
        self._track: list[Floats] = []
        self._recent: deque[Floats] = deque(maxlen=MEDIAN_COUNT)
        self._refined: dict[ParkingSpace, ParkingSpace] = {}  # refined estimates by first estimate

    def _prior(self, edges: Sequence[float]) -> tuple[Floats, Floats]:
        """Return mean and covariance at the start, with the known edges of boxes."""
        s = self.settings
        mean = [0.0, 0.0, 0.0, 0.0, s.wall[0], s.face[0], s.face[0] - s.depth[0], *edges]
        kerb = float(np.hypot(s.face[1], s.depth[1]))
        sd = [START_SD, START_SD, s.heading_sd, s.bias_sd, s.wall[1], s.face[1], kerb]
        covariance = np.diag(np.square([*sd, *[s.edge_sd] * len(edges)]))
        covariance[FACE, KERB] = covariance[KERB, FACE] = s.face[1] ** 2
        return np.array(mean), covariance

    @property
    def pose(self) -> Floats:
        """Pose of the rear axle in the street frame: m, m, rad, (3,)."""
        return self.state[:3].copy()

    # ---- filter ------------------------------------------------------------------------------------------------------

    def update(self, odometry: Floats, reading: Floats, credence: Floats) -> None:
        """Process a step.

        Args:
            odometry: pose since the start, m, m, rad, (3,).
            reading: m, (n,); ignored without an echo.
            credence: given the readings, (n,); 0 without an echo.
        """
        last = odometry if self._last is None else self._last
        motion = np.array([*kernels.to_frame(odometry[0], odometry[1], last), odometry[2] - last[2]])
        motion[2] = (motion[2] + np.pi) % (2.0 * np.pi) - np.pi
        self._last = odometry.copy()
        self._recent.append(np.where(credence > 0.0, reading, self.max_range))
        step = FilterInput(motion, reading, np.minimum(credence, 1.0 - self.settings.min_error))
        self._process(step)
        if self._space_edge is None:
            self._inputs.append(step)
            self._track.append(self.state)

    def _process(self, step: FilterInput) -> None:
        self._predict(step.motion)
        credence = np.where(self._used, step.credence, 0.0) if self._space_edge is None else step.credence
        sonars = self._poses, self._half, step.reading, credence
        self.state, self.covariance = update_all(
            self.state, self.covariance, *sonars, self._free, self._tolerance, self.max_range
        )

    def _predict(self, motion: Floats) -> None:
        """Move by odometry, corrected for its estimated bias, which has the opposite sign when driving backwards."""
        before, distance = self.state.copy(), float(motion[0])
        jacobian = np.eye(len(before))
        c, s = np.cos(before[HEADING]), np.sin(before[HEADING])
        self.state[X] += c * motion[0] - s * motion[1]
        self.state[Y] += s * motion[0] + c * motion[1]
        self.state[HEADING] += motion[2] - before[BIAS] * distance
        jacobian[X, HEADING], jacobian[Y, HEADING], jacobian[HEADING, BIAS] = -s * distance, c * distance, -distance
        noise = np.zeros(len(before))
        noise[X] = self.settings.slip_sd**2 * abs(distance)
        noise[HEADING] = self.settings.heading_walk_sd**2 * abs(distance)
        self.covariance = jacobian @ self.covariance @ jacobian.T + np.diag(noise)

    # ---- spaces ------------------------------------------------------------------------------------------------------

    def edges(self) -> list[float]:
        """Return both ends of the boxes that the front sonar on the right has passed, x in m, in order."""
        i = self.index[BOX_SONAR]
        along = np.array([in_world(self._poses[i : i + 1], state[:3])[0, 0] for state in self._track])
        reading = np.array([step.reading[i] for step in self._inputs])
        credence = np.array([step.credence[i] for step in self._inputs])
        threshold = box_distance(reading[credence > MIN_CREDENCE]) + JUMP
        moved = np.abs(np.diff(along, prepend=along[0]))
        far_share = 1.0 - threshold / self.max_range
        probability = space_probability(reading > threshold, credence, moved, far_share, self.settings.edge_rate)
        corner = threshold * np.sin(self._half[i])
        runs = find_runs(probability > 0.5)
        runs = runs[1:] if runs[0][2] else runs  # the opening before the first box is not a space
        out = [along[begin] + (-corner if far else corner) for begin, _, far in runs]
        return [along[0] - corner, *out[1:]] if runs and runs[0][0] == 0 else out

    def spaces(self) -> list[ParkingSpace]:
        """Return the spaces passed so far, those of about the needed length refined; the last may have no end yet."""
        edges = [*self.edges(), np.inf]
        coarse = [ParkingSpace(begin, end) for begin, end in zip(edges[1:-1:2], edges[2::2], strict=True)]
        return [
            self._refine(space) if REFINE_LENGTHS[0] < space.length < REFINE_LENGTHS[1] else space for space in coarse
        ]

    def _refine(self, space: ParkingSpace) -> ParkingSpace:
        """Return the estimate of a space from all readings, computed once per first estimate."""
        if space not in self._refined:
            backup = self.state, self.covariance, self._free
            self.select(space)
            assert self.space is not None
            self._refined[space] = self.space
            self._space_edge = None
            self.state, self.covariance, self._free = backup
        return self._refined[space]

    def select(self, space: ParkingSpace) -> None:
        """Select a space: run the filter again over all steps with the edges up to this space in the state."""
        edges = np.array(self.edges())
        first = int(np.argmin(np.abs(edges - space.begin)))
        edges = edges[: first + 2]
        self._space_edge = EDGES + first
        self.state, self.covariance = self._prior(edges.tolist())
        self._free = np.ones(len(self.state))
        self._free[[X, *range(EDGES, len(self.state))]] = 0.0  # x and the edges are not observable apart yet
        track = [self._processed_pose(step) for step in self._inputs]
        self._free[:] = 1.0
        self.covariance[X], self.covariance[:, X] = 0.0, 0.0  # from here on x is relative to the current position
        for k in range(EDGES, len(self.state)):
            self._locate_edge(k, track)

    def _processed_pose(self, step: FilterInput) -> Floats:
        self._process(step)
        return self.state[:3].copy()

    def _locate_edge(self, k: int, track: list[Floats]) -> None:
        """Set mean and variance of an edge to those of its posterior on a grid, from all sonars on the right."""
        at = self.state[k] + np.linspace(-EDGE_SEARCH, EDGE_SEARCH, EDGE_POINTS)
        used = [self.index[name] for name in BOX_SONARS]
        log = np.zeros(EDGE_POINTS)
        for pose, step in zip(track, self._inputs, strict=True):
            poses = in_world(self._poses[used], pose)
            near = np.abs(poses[:, 0] - self.state[k]) < EDGE_NEIGHBOURHOOD
            if near.any():
                sonars = self._half[used][near], step.reading[used][near], step.credence[used][near]
                log += edge_log_likelihood(self.state, k, at, poses[near], *sonars, self._tolerance, self.max_range)
        posterior = np.exp(log - log.max())
        posterior /= posterior.sum()
        mean = float(posterior @ at)
        self.state[k] = mean
        self.covariance[k], self.covariance[:, k] = 0.0, 0.0
        self.covariance[k, k] = float(posterior @ (at - mean) ** 2) + EDGE_SD_FLOOR**2

    # ---- output ------------------------------------------------------------------------------------------------------

    @property
    def kerb(self) -> float:
        """Estimated y of the kerb, m."""
        return float(self.state[KERB])

    @property
    def space(self) -> ParkingSpace | None:
        """The selected space, by its current estimate; None before a selection."""
        if self._space_edge is None:
            return None
        return ParkingSpace(float(self.state[self._space_edge]), float(self.state[self._space_edge + 1]))

    def clearance(self, name: str) -> float:
        """Return the median of the last readings of a sonar, m; no echo counts as the maximum range."""
        return float(np.median([reading[self.index[name]] for reading in self._recent]))
