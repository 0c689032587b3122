"""Measurement model of a street of straight lines, and inference from readings that may be wrong, compiled.

The state consists of the car's pose, the curvature bias of its odometry, and the lines of the street.
"""

from __future__ import annotations

import numpy as np

from acquisition.arrays import Bits, Floats
from sonar_gym.compiled import compiled
from sonar_gym.sensing import kernels

X, Y, HEADING, BIAS, WALL, FACE, KERB, EDGES = range(8)  # indices of the state; the edges of the boxes follow
FAR_M = 30.0  # m; extent of the lines of the street to either side
DIFFERENCE = 1e-4  # m, rad; step of the finite differences
# Project choices: no echo from a face at less than NORMAL_ANGLE of incidence has probability NORMAL_MISS, else 0.5.
NORMAL_ANGLE, NORMAL_MISS = np.radians(25.0), 0.1
OBLIQUE_ANGLE = np.radians(15.0)  # project choice: bearing or incidence that doubles the standard deviation


@compiled
def street_segments(state: Floats) -> Floats:
    """Return the street as segments, m, (2 + edges + boxes, 4): wall, kerb, ends of the boxes, faces of the boxes.

    Edges are the beginnings and ends of the boxes in turn; the last box may have no end.
    """
    wall, face, kerb, edges = state[WALL], state[FACE], state[KERB], state[EDGES:]
    count = len(edges)
    out = np.empty((2 + count + (count + 1) // 2, 4))
    out[0] = np.array([-FAR_M, wall, FAR_M, wall])
    out[1] = np.array([-FAR_M, kerb, FAR_M, kerb])
    for j in range(count):
        out[2 + j] = np.array([edges[j], face, edges[j], kerb])
    for box in range((count + 1) // 2):
        end = edges[2 * box + 1] if 2 * box + 1 < count else FAR_M
        out[2 + count + box] = np.array([edges[2 * box], face, end, face])
    return out


@compiled
def expected_ranges(state: Floats, mounts: Floats, half: Floats, limit: float) -> Floats:
    """Return the readings without noise, m, (n,); `limit` where a cone is empty."""
    return kernels.cast_cones(kernels.mounted(mounts, state[:3]), half, street_segments(state), limit)[0]


@compiled
def linearise(state: Floats, mounts: Floats, half: Floats, limit: float, step: float) -> tuple[Floats, Floats]:
    """Return the expected readings, m, (n,), and their Jacobian by central differences, (n, k)."""
    at, slopes = expected_ranges(state, mounts, half, limit), np.zeros((len(half), len(state)))
    for k in range(len(state)):
        up, down = state.copy(), state.copy()
        up[k] += step
        down[k] -= step
        change = expected_ranges(up, mounts, half, limit) - expected_ranges(down, mounts, half, limit)
        slopes[:, k] = change / (2.0 * step)
    return at, slopes


@compiled
def pda_update(
    state: Floats,
    covariance: Floats,
    at: Floats,
    slope: Floats,
    reading: float,
    credence: float,
    sigma: float,
    span: float,
) -> tuple[Floats, Floats]:
    """Return mean and covariance of the state after one reading, by probabilistic data association.

    Args:
        state: mean, (k,).
        covariance: (k, k).
        at: expected reading, m.
        slope: its gradient, (k,).
        reading: m.
        credence: prior probability that the reading is correct.
        sigma: standard deviation of a correct reading, m.
        span: a wrong reading is uniform in 0..`span`, m.
    """
    across = covariance @ slope
    variance = slope @ across + sigma * sigma
    off = reading - at
    correct = credence * np.exp(-0.5 * off * off / variance) / np.sqrt(2.0 * np.pi * variance)
    weight = correct / (correct + (1.0 - credence) / span)
    gain = across / variance
    # with probability 1 - weight the state is unchanged; the last term is the spread between both means
    reduction = weight * (1.0 - (1.0 - weight) * off * off / variance)
    return state + weight * off * gain, covariance - reduction * np.outer(gain, across)


@compiled
def edge_log_likelihood(
    state: Floats,
    k: int,
    at: Floats,
    poses: Floats,
    half: Floats,
    reading: Floats,
    credence: Floats,
    tolerance: tuple[float, float],
    limit: float,
) -> Floats:
    """Return the log likelihood of readings for each candidate position of an edge, (g,).

    No echo is improbable from a face near normal incidence, and as probable as an echo otherwise.

    Args:
        state: mean, (k,).
        k: index of the edge in the state.
        at: candidate positions, x in m, (g,).
        poses: poses of the sonars in the street, (n, 3).
        half: half opening angles of their cones, rad, (n,).
        reading: m, (n,).
        credence: (n,); 0 without an echo.
        tolerance: standard deviation of a correct reading as a fraction of the expected one, and its floor, m.
        limit: maximum range, m.
    """
    out, moved = np.zeros(len(at)), state.copy()
    for g in range(len(at)):
        moved[k] = at[g]
        distance, _, incidence, _, _ = kernels.cast_cones(poses, half, street_segments(moved), limit)
        for i in range(len(half)):
            miss = NORMAL_MISS if distance[i] < limit and incidence[i] < NORMAL_ANGLE else 0.5
            if credence[i] == 0.0:
                out[g] += np.log(miss)
                continue
            sigma = max(tolerance[0] * distance[i], tolerance[1])
            off = (reading[i] - distance[i]) / sigma
            correct = credence[i] * np.exp(-0.5 * off * off) / (np.sqrt(2.0 * np.pi) * sigma)
            out[g] += np.log((1.0 - miss) * (correct + (1.0 - credence[i]) / limit))
    return out


@compiled
def update_all(
    state: Floats,
    covariance: Floats,
    mounts: Floats,
    half: Floats,
    reading: Floats,
    credence: Floats,
    free: Floats,
    tolerance: tuple[float, float],
    limit: float,
) -> tuple[Floats, Floats]:
    """Return mean and covariance of the state after all readings of a step, in turn, about one linearisation.

    Args:
        state: mean, (k,).
        covariance: (k, k).
        mounts: poses of the sonars on the car, (n, 3).
        half: half opening angles of their cones, rad, (n,).
        reading: m, (n,).
        credence: prior probability that each is correct, (n,); 0: not used.
        free: 1 for components that the readings may update, else 0, (k,).
        tolerance: standard deviation of a correct reading as a fraction of the expected one, and its floor, m.
        limit: maximum range, m.
    """
    origin = state.copy()
    at, slope = linearise(origin, mounts, half, limit, DIFFERENCE)
    slope *= free
    _, bearing, incidence, _, _ = kernels.cast_cones(
        kernels.mounted(mounts, state[:3]), half, street_segments(state), limit
    )
    for i in range(len(half)):
        if credence[i] > 0.0 and at[i] < limit:
            here = at[i] + slope[i] @ (state - origin)
            oblique = 1.0 + (bearing[i] ** 2 + incidence[i] ** 2) / OBLIQUE_ANGLE**2
            sigma = oblique * max(tolerance[0] * at[i], tolerance[1])
            state, covariance = pda_update(state, covariance, here, slope[i], reading[i], credence[i], sigma, limit)
    return state, covariance


def space_probability(far: Bits, credence: Floats, step: Floats, far_share: float, rate: float) -> Floats:
    """Return the probability that there was no box beside a sonar at each of its readings, given all readings, (n,).

    Hidden Markov model with the states box and space, by the forward-backward algorithm (Rabiner 1989). A reading is
    correct with its credence; a wrong one is near or far independently of the state.

    Args:
        far: whether each reading is farther than the face of a box, (n,).
        credence: (n,); 0: the reading is not used.
        step: distance from the previous reading, m, (n,).
        far_share: fraction of the maximum range that counts as far, 0..1.
        rate: rate of transitions, 1/m.
    """
    wrong = (1.0 - credence) * np.where(far, far_share, 1.0 - far_share)
    likelihood = np.stack([np.where(far, 0.0, credence) + wrong, np.where(far, credence, 0.0) + wrong], axis=1)
    likelihood = np.where(credence[:, None] > 0.0, likelihood, 1.0)
    change = 0.5 * -np.expm1(-2.0 * rate * step)  # of a chain with this rate in both directions
    return _forward_backward(likelihood, change)


@compiled
def _forward_backward(likelihood: Floats, change: Floats) -> Floats:
    n = len(change)
    forward, backward = np.empty((n, 2)), np.ones((n, 2))
    before = np.full(2, 0.5)
    for k in range(n):
        before = _predicted(before, change[k]) * likelihood[k]
        before = before / before.sum()
        forward[k] = before
    for k in range(n - 2, -1, -1):
        later = _predicted(backward[k + 1] * likelihood[k + 1], change[k + 1])
        backward[k] = later / later.sum()
    both = forward * backward
    return both[:, 1] / both.sum(axis=1)


@compiled
def _predicted(share: Floats, change: float) -> Floats:
    return np.array([share[0] + change * (share[1] - share[0]), share[1] + change * (share[0] - share[1])])
