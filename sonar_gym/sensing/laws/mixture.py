"""The law of a network's outputs, compiled: a reading and its credence; the formulas of `noise.learned.mixture`."""

from __future__ import annotations

import math
from typing import NamedTuple

from acquisition.arrays import Floats, Singles
from noise.law import CREDENCE_TOLERANCE
from noise.learned.mixture import FLOOR, HALF_UNIFORM_EXCESS, UNIT_M, WIDENING, Head
from sonar_gym.sensing.laws.dense import fused, logistic

NO_ECHO, ECHO, NO_ANSWER = 0, 1, 2  # as acquisition.EchoStatus
MAX_COMPONENTS = 64  # of a law that is compiled
LEAST_SHARE = 2.0 * FLOOR  # a component with less is left out of the credence, which changes it by 2e-4 at most


class Shape(NamedTuple):
    """A `Head` as numbers.

    Attributes:
        near, fixed, anchored: numbers of components.
        fails: whether there is an output for no answer.
        answers: probability of an answer, if it is equal for all pings.
        resolution: step of the register, m.
        max_range: range of its last step, m.
        last_step: number of its last step.
    """

    near: int
    fixed: int
    anchored: int
    fails: bool
    answers: float
    resolution: float
    max_range: float
    last_step: int

    @classmethod
    def of(cls, head: Head) -> Shape:
        """Return the numbers of a head."""
        last_step = max(1, round(head.max_range / head.resolution))
        counts = head.near, head.fixed, head.anchored, head.fails
        return cls(*counts, 1.0 - head.no_answer, head.resolution, head.max_range, last_step)


@fused
def centre(y: Singles, r: int, k: int, shape: Shape, distance: float, anchor_1: float, anchor_2: float) -> float:
    """Return the location of component k of ping r, m."""
    own, at = shape.near + shape.fixed, shape.near + shape.fixed + shape.anchored + 2 + int(shape.fails) + k
    if shape.near <= k < own:
        return shape.max_range * logistic(y[at, r])
    about = distance if k < shape.near else anchor_1 if k == own else anchor_2
    return about + UNIT_M * math.sinh(min(max(y[at, r], -7.0), 7.0))


@fused
def scale(y: Singles, r: int, k: int, shape: Shape, excess: float) -> float:
    """Return the width of component k of ping r, m."""
    count = shape.near + shape.fixed + shape.anchored
    value = y[2 * count + 2 + int(shape.fails) + k, r]
    return (0.1 * shape.resolution + UNIT_M * math.exp(min(max(value, -8.0), 6.0))) * (1.0 + WIDENING * excess)


@fused
def shares(y: Singles, r: int, shape: Shape, excess: float, out: Floats) -> None:
    """Write the probabilities of the components, the uniform component and no echo of ping r."""
    outcomes = shape.near + shape.fixed + shape.anchored + 2
    top, total = y[0, r], 0.0
    for k in range(outcomes):
        top = max(top, y[k, r])
    for k in range(outcomes):
        out[k] = math.exp(y[k, r] - top)
        total += out[k]
    uniform = excess / (excess + HALF_UNIFORM_EXCESS)
    for k in range(outcomes):
        out[k] = (FLOOR + (1.0 - FLOOR * outcomes) * out[k] / total) * (1.0 - uniform)
        if k >= outcomes - 2:
            out[k] += 0.5 * uniform


@fused
def edge(step: float, shape: Shape) -> float:
    """Return the upper edge of a step of the register, m; see `EchoLaw.edge`."""
    if step < 1.0:
        return -math.inf
    return math.inf if step >= shape.last_step else (step + 0.5) * shape.resolution


@fused
def draw(
    y: Singles,
    r: int,
    shape: Shape,
    distance: float,
    excess: float,
    anchors: tuple[float, float],
    uniform: tuple[float, float],
    share: Floats,
) -> tuple[float, int, float]:
    """Return the range, m, the status, and the credence given the condition of ping r.

    Args:
        y: outputs of a network, (width, BLOCK).
        r: number of the ping in the block.
        shape: meaning of the outputs.
        distance: true distance, m.
        excess: distance of the condition from the learned ones, relative to their width.
        anchors: ranges about which the anchored components lie, m.
        uniform: random numbers for the outcome and for the range within it.
        share: scratch, (MAX_COMPONENTS + 2,).
    """
    shares(y, r, shape, excess, share)
    count, fails = shape.near + shape.fixed + shape.anchored, shape.fails
    rate = logistic(-y[count + 2, r]) if fails else shape.answers
    low = edge(math.ceil((1.0 - CREDENCE_TOLERANCE) * distance / shape.resolution - 1e-9) - 1.0, shape)
    high = edge(math.floor((1.0 + CREDENCE_TOLERANCE) * distance / shape.resolution + 1e-9), shape)
    end = shape.max_range
    right = share[count] * (min(max(high / end, 0.0), 1.0) - min(max(low / end, 0.0), 1.0))
    below, place, status, found = 0.0, uniform[1] * end, ECHO, False
    for k in range(count):
        chosen = not found and uniform[0] < rate * (below + share[k])
        if chosen or share[k] > LEAST_SHARE:
            at, spread = centre(y, r, k, shape, distance, anchors[0], anchors[1]), scale(y, r, k, shape, excess)
            right += share[k] * (logistic((high - at) / spread) - logistic((low - at) / spread))
            if chosen:
                found, place = True, at + spread * (math.log(uniform[1]) - math.log1p(-uniform[1]))
        below += share[k]
    if not found and uniform[0] >= rate * (below + share[count]):
        status = NO_ECHO if uniform[0] < rate else NO_ANSWER
    step = min(max(round(place / shape.resolution), 1), shape.last_step)
    return (step * shape.resolution if status == ECHO else 0.0), status, min(max(rate * right, 0.0), 1.0)
