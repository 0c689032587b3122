"""Imitation of a teacher that knows the true state, by dataset aggregation (DAgger).

References:
    Ross, Gordon, Bagnell (2011), "A reduction of imitation learning to no-regret online learning".
    Chen et al. (2019), "Learning by cheating": a teacher with privileged knowledge, an agent that observes readings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from torch.nn import functional as F

from acquisition.arrays import Bits, Floats, Singles
from sonar_gym.parking.fleet import Fleet
from sonar_gym.parking.step_kernel import GOAL_X, GOAL_Y, READY_X, TURN
from sonar_gym.street.street import arc_radius
from training.agents.vec_env import AgentVecEnv

# ---- the teacher -----------------------------------------------------------------------------------------------------

CRUISE, MIN_FORWARD = 0.40, 0.15  # m/s forwards, highest and lowest
MAX_REVERSE, MIN_REVERSE = 0.16, 0.10  # m/s backwards
STIFFNESS, DAMPING = 16.0, 8.0  # 1/m^2, 1/m; path errors decay within 0.25 m
SPEED_GAIN = 2.0  # 1/s; speed per metre to the start of the path
MAX_OFF_PATH, MAX_TURNED = 0.12, 0.35  # m, rad; beyond these errors the car drives out and tries again
LANE_WIDTH = 0.10  # m from the lane's centre within which the lane is followed instead of the path
START_BEFORE, START_BEYOND = 0.02, 0.30  # m before and beyond the start: where reversing may, and where it must, begin
START_ERROR = 0.05  # m from the lane's centre, and half the heading error in rad, allowed at the start
FINAL_LENGTH, MAX_FINAL_TURNED = 0.15, 0.15  # m, rad; allowed heading error on the last part of the path
STOP = 0.01  # m of path left at which the car stops
STEER_EARLY = 0.05  # m before the change of curvature at which the wheels turn
POINTS = 120  # points of the path among which the nearest is searched


class PathPosition(NamedTuple):
    """Positions of cars relative to the two arcs into their spaces, each (n,).

    Attributes:
        to_start: distance along the lane to the start of the path, m.
        travelled, remaining: length of path before and after the nearest point, m.
        off: offset to the left of the nearest point, m.
        turned: heading error to the left, rad.
        curvature: curvature of the path, 1/m.
    """

    to_start: Floats
    travelled: Floats
    remaining: Floats
    off: Floats
    turned: Floats
    curvature: Floats


class Teacher:
    """Drives n cars along the reference path from their true poses.

    The teacher has no state besides the direction in which a car has moved, which the agent's memory shows as well.
    With hidden plans, the same observation would be labelled both with driving out and with reversing.

    Args:
        fleet: cars and their streets.
    """

    def __init__(self, fleet: Fleet) -> None:
        self.fleet = fleet
        self.radius = arc_radius(fleet.car_settings)

    def act(self, way: Floats) -> Floats:
        """Return steering and speed of each car as fractions of their maxima, (n, 2).

        Args:
            way: distance moved since the last change of direction (`ObservationMemory.travel`), m, (n,).
        """
        car, pose = self.fleet.car_settings, self.fleet.worlds.car[:, :3]
        at = self._nearest(pose, self.fleet.worlds.task)
        reversing = _reversing(pose, at, way)
        lane = -STIFFNESS * pose[:, 1] - DAMPING * pose[:, 2]
        on_path = at.curvature - STIFFNESS * at.off - DAMPING * at.turned
        forward = np.where(np.abs(pose[:, 1]) < LANE_WIDTH, lane, on_path)
        backward = at.curvature - STIFFNESS * at.off + DAMPING * at.turned
        steering = np.arctan(car.wheelbase * np.where(reversing, backward, forward))
        fastest = np.where(np.abs(pose[:, 2]) < 2.0 * START_ERROR, CRUISE, MIN_FORWARD)
        forward_speed = np.clip(SPEED_GAIN * at.to_start, MIN_FORWARD, fastest)
        backward_speed = np.where(at.remaining < STOP, 0.0, -np.minimum(MAX_REVERSE, MIN_REVERSE + at.remaining))
        speed = np.where(reversing, backward_speed, forward_speed)
        action = np.column_stack([steering / car.max_steering, speed / car.max_speed])
        return np.clip(action, -1.0, 1.0)

    def _nearest(self, pose: Floats, task: Floats) -> PathPosition:
        """Return the positions of cars at the nearest points of their paths."""
        r, turn, start = self.radius, task[:, TURN, None], task[:, READY_X]
        length = np.linspace(0.0, 1.0, POINTS) * 2.0 * r * turn
        first_arc = length < r * turn
        angle = np.where(first_arc, length / r, 2.0 * turn - length / r)
        along, across = r * np.sin(angle), r * (1.0 - np.cos(angle))
        x = np.where(first_arc, task[:, READY_X, None] - along, task[:, GOAL_X, None] + along)
        y = np.where(first_arc, -across, task[:, GOAL_Y, None] + across)
        away = np.hypot(x - pose[:, :1], y - pose[:, 1:2]) + 0.1 * np.abs(angle - pose[:, 2:])
        k, row = np.argmin(away, axis=1), np.arange(len(pose))
        reference, travelled = np.column_stack([x[row, k], y[row, k], angle[row, k]]), length[row, k]
        bend = np.where(travelled + STEER_EARLY < r * turn[:, 0], -1.0, 1.0) / r
        curvature = np.where(pose[:, 0] > start, 0.0, bend)
        remaining = 2.0 * r * turn[:, 0] - travelled
        off, turned = _left_of(pose, reference), pose[:, 2] - reference[:, 2]
        return PathPosition(start - pose[:, 0], travelled, remaining, off, turned, curvature)


def _reversing(pose: Floats, at: PathPosition, way: Floats) -> Bits:
    """Return which cars reverse: those at the start of the path, or reversing already and near the path."""
    max_turned = np.where(at.remaining < FINAL_LENGTH, MAX_FINAL_TURNED, MAX_TURNED)
    off_path = (np.abs(at.off) > MAX_OFF_PATH) | (np.abs(at.turned) > max_turned)
    aligned = (np.abs(pose[:, 1]) < START_ERROR) & (np.abs(pose[:, 2]) < 2.0 * START_ERROR)
    at_start = (at.to_start < START_BEFORE) & aligned | (at.to_start < -START_BEYOND)
    return at_start | (way < 0.0) & ~(off_path & (at.travelled > 0.0))


def _left_of(pose: Floats, reference: Floats) -> Floats:
    """Return the offset of poses to the left of reference poses, m, (n,)."""
    dx, dy, turn = pose[:, 0] - reference[:, 0], pose[:, 1] - reference[:, 1], reference[:, 2]
    return np.cos(turn) * dy - np.sin(turn) * dx


# ---- imitation -------------------------------------------------------------------------------------------------------

LOSS_BETA = 0.05  # errors below this contribute quadratically
FINAL_RATE = 0.03  # fraction of the learning rate at the end of its linear decay


@dataclass(frozen=True)
class ImitationSettings:
    """Settings of imitation.

    Attributes:
        rounds: number of labelled decisions of each car.
        teacher_share: share of the rounds over which the teacher's part of the driving falls to zero.
        buffer_size: number of labelled decisions in the buffer; new ones replace the oldest.
        batches: optimiser steps per round.
        batch_size: labelled decisions per optimiser step.
        learning_rate: initial learning rate of Adam.
    """

    rounds: int = 3000
    teacher_share: float = 0.2
    buffer_size: int = 300_000
    batches: int = 2
    batch_size: int = 1024
    learning_rate: float = 1e-3


class LabelBuffer:
    """Ring buffer of observations with the teacher's actions.

    Args:
        size: capacity.
        shown: length of an observation.
        actions: length of an action.
    """

    def __init__(self, size: int, shown: int, actions: int) -> None:
        self._shown = np.zeros((size, shown), dtype=np.float32)
        self._action = np.zeros((size, actions), dtype=np.float32)
        self.count = 0

    def add(self, shown: Singles, action: Floats) -> None:
        """Add observations, (n, shown), with actions, (n, actions)."""
        place = np.arange(self.count, self.count + len(shown)) % len(self._shown)
        self._shown[place], self._action[place] = shown, action
        self.count += len(shown)

    def draw(self, count: int, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Return random observations and actions, with replacement."""
        rows = rng.integers(0, min(self.count, len(self._shown)), count)
        return torch.from_numpy(self._shown[rows]), torch.from_numpy(self._action[rows])


def mean_action(policy: ActorCriticPolicy, shown: torch.Tensor) -> torch.Tensor:
    """Return the mean of a policy's action distribution, (n, 2)."""
    features = policy.extract_features(shown, policy.pi_features_extractor)
    assert isinstance(features, torch.Tensor)
    latent = policy.mlp_extractor.forward_actor(features)
    mean: torch.Tensor = policy.action_net(latent)
    return mean


def imitate(
    policy: ActorCriticPolicy,
    envs: AgentVecEnv,
    settings: ImitationSettings,
    rng: np.random.Generator,
    on_round: Callable[[int, float], None] = lambda done, loss: None,
) -> None:
    """Train a policy to imitate the teacher.

    The teacher drives at first and the agent later; the teacher labels all decisions. The loss is linear in large
    errors: a squared loss would average two equally good actions, which may mean standing still.

    Args:
        policy: policy to train.
        envs: the cars, seeded.
        settings: settings of imitation.
        rng: decides who drives and which labels are drawn.
        on_round: called after each round with the number of rounds and the last loss.
    """
    teachers = [Teacher(venv.envs.fleet) for venv in envs.venvs]
    buffer = LabelBuffer(max(settings.buffer_size, envs.num_envs), envs.memory.size, envs.action_space.shape[0])  # type: ignore[index]
    actor = [*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters()]
    adam = torch.optim.Adam(actor, lr=settings.learning_rate)
    shown, teacher_drives = np.asarray(envs.reset()), np.ones(envs.num_envs, dtype=np.bool_)
    for done in range(settings.rounds):
        ways = (envs.memory.travel[part] for part in envs.parts)
        labels = np.concatenate([teacher.act(way) for teacher, way in zip(teachers, ways, strict=True)])
        buffer.add(shown, labels)
        with torch.no_grad():
            own = np.clip(mean_action(policy, torch.from_numpy(shown)).numpy(), -1.0, 1.0)
        shown, _, ended, _ = envs.advance(np.where(teacher_drives[:, None], labels, own).astype(np.float32))
        share = max(0.0, 1.0 - done / (settings.teacher_share * settings.rounds))
        teacher_drives[ended] = rng.random(int(ended.sum())) < share
        adam.param_groups[0]["lr"] = settings.learning_rate * max(FINAL_RATE, 1.0 - done / settings.rounds)
        loss = [_learn(policy, adam, *buffer.draw(settings.batch_size, rng)) for _ in range(settings.batches)][-1]
        on_round(done + 1, loss)


def _learn(policy: ActorCriticPolicy, adam: torch.optim.Adam, shown: torch.Tensor, labels: torch.Tensor) -> float:
    loss = F.smooth_l1_loss(mean_action(policy, shown), labels, beta=LOSS_BETA)
    adam.zero_grad()
    loss.backward()
    adam.step()
    return float(loss.detach())
