"""What sonars would read in a street of straight lines, and what a reading that may be wrong tells of it.

A state holds the car's pose, the pull of its steering and the street's lines; `sonar_gym.control.fusion` keeps one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sonar_gym.compiled import compiled
from sonar_gym.sensing import kernels

Floats = NDArray[np.float64]
X, Y, HEADING, PULL, WALL, FACE, KERB, EDGES = range(8)  # places in the state; edges of boxes are the rest
FAR_M = 30.0  # m; lines of the street are this long to either side
STEP = 1e-4  # m, rad; of the differences that give slopes
SQUARE, SILENT = np.radians(25.0), 0.1  # met at less than this, a face is rarely silent: ours
ASKEW = np.radians(15.0)  # off the beam, or off a face's normal: here the spread is twice that met squarely; ours


@compiled
def faces_of(state: Floats) -> Floats:
    """Return the street as segments, m, (2 + edges + boxes, 4): wall, kerb, the boxes' ends and their faces.

    Edges are where boxes begin and end by turns; the last box has no end.
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
def expected(state: Floats, mounts: Floats, half: Floats, limit: float) -> Floats:
    """Return what the sonars would read in a street without noise, m, (n,); `limit` where their cones are empty."""
    return kernels.cast_cones(kernels.mounted(mounts, state[:3]), half, faces_of(state), limit)[0]


@compiled
def linearised(state: Floats, mounts: Floats, half: Floats, limit: float, step: float) -> tuple[Floats, Floats]:
    """Return what is expected, m, (n,), and its slopes in every number of the state by differences, (n, states)."""
    at, slopes = expected(state, mounts, half, limit), np.zeros((len(half), len(state)))
    for k in range(len(state)):
        up, down = state.copy(), state.copy()
        up[k] += step
        down[k] -= step
        slopes[:, k] = (expected(up, mounts, half, limit) - expected(down, mounts, half, limit)) / (2.0 * step)
    return at, slopes


@compiled
def associated(
    state: Floats, spread: Floats, at: Floats, slope: Floats, reading: float, credence: float, sigma: float, span: float
) -> tuple[Floats, Floats]:
    """Return state and covariance after one reading that may be wrong.

    Args:
        state: mean, (k,).
        spread: covariance, (k, k).
        at: what is expected of the reading at the state, m.
        slope: of the expectation, (k,).
        reading: m.
        credence: prior probability that it is right.
        sigma: its spread where it is right, m.
        span: it may be anything in 0 to `span` where it is wrong, m.
    """
    across = spread @ slope
    variance = slope @ across + sigma * sigma
    off = reading - at
    right = credence * np.exp(-0.5 * off * off / variance) / np.sqrt(2.0 * np.pi * variance)
    weight = right / (right + (1.0 - credence) / span)
    gain = across / variance
    # with probability 1 - weight nothing was learned; the last term is the spread between both means
    narrower = weight * (1.0 - (1.0 - weight) * off * off / variance)
    return state + weight * off * gain, spread - narrower * np.outer(gain, across)


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
    """Return the log likelihood of some readings for each place at which an edge may be, (g,).

    Faces met askew may stay silent, those met squarely rarely do.

    Args:
        state: of the filter, (k,).
        k: which number of it is the edge.
        at: where it may be, x in m, (g,).
        poses: of the sonars in the street, (n, 3).
        half: half angles of their cones, rad, (n,).
        reading: m, (n,).
        credence: of each, (n,); 0 is silence.
        tolerance: spread of a right reading as a share of what is expected, and its least, m.
        limit: of the sonars' range, m.
    """
    out, moved = np.zeros(len(at)), state.copy()
    for g in range(len(at)):
        moved[k] = at[g]
        distance, _, incidence, _, _ = kernels.cast_cones(poses, half, faces_of(moved), limit)
        for i in range(len(half)):
            silence = SILENT if distance[i] < limit and incidence[i] < SQUARE else 0.5
            if credence[i] == 0.0:
                out[g] += np.log(silence)
                continue
            sigma = max(tolerance[0] * distance[i], tolerance[1])
            off = (reading[i] - distance[i]) / sigma
            right = credence[i] * np.exp(-0.5 * off * off) / (np.sqrt(2.0 * np.pi) * sigma)
            out[g] += np.log((1.0 - silence) * (right + (1.0 - credence[i]) / limit))
    return out


@compiled
def heard_all(
    state: Floats,
    spread: Floats,
    mounts: Floats,
    half: Floats,
    reading: Floats,
    credence: Floats,
    free: Floats,
    tolerance: tuple[float, float],
    limit: float,
) -> tuple[Floats, Floats]:
    """Return state and covariance after all readings of a step, one by one about one linearisation.

    Args:
        state: mean, (k,).
        spread: covariance, (k, k).
        mounts: poses of the sonars on the car, (n, 3).
        half: half angles of their cones, rad, (n,).
        reading: m, (n,).
        credence: prior probability that each is right, (n,); 0 for those that say nothing.
        free: 1 for what may be learned, 0 for what is taken as it is, (k,).
        tolerance: spread of a right reading as a share of what is expected, and its least, m.
        limit: of the sonars' range, m.
    """
    about = state.copy()
    at, slope = linearised(about, mounts, half, limit, STEP)
    slope *= free
    _, bearing, incidence, _, _ = kernels.cast_cones(kernels.mounted(mounts, state[:3]), half, faces_of(state), limit)
    for i in range(len(half)):
        if credence[i] > 0.0 and at[i] < limit:
            here = at[i] + slope[i] @ (state - about)
            askew = 1.0 + (bearing[i] ** 2 + incidence[i] ** 2) / ASKEW**2
            sigma = askew * max(tolerance[0] * at[i], tolerance[1])
            state, spread = associated(state, spread, here, slope[i], reading[i], credence[i], sigma, limit)
    return state, spread


def opened(far: NDArray[np.bool_], credence: Floats, step: Floats, span: float, hazard: float) -> Floats:
    """Return the probability that there was no box beside a sonar at each of its readings, given all of them, (n,).

    A hidden Markov chain of two states, box and none, by the forward-backward algorithm (Rabiner 1989). A reading is
    right with its credence; a wrong one is near or far with probabilities that do not depend on the state.

    Args:
        far: whether each reading is farther than a box's face would be, (n,).
        credence: of each, (n,); 0 tells nothing.
        step: way from the reading before, m, (n,).
        span: share of the range that counts as far, 0..1.
        hazard: how often boxes begin or end, 1/m.
    """
    wrong = (1.0 - credence) * np.where(far, span, 1.0 - span)
    likely = np.stack([np.where(far, 0.0, credence) + wrong, np.where(far, credence, 0.0) + wrong], axis=1)
    likely = np.where(credence[:, None] > 0.0, likely, 1.0)
    change = 0.5 * -np.expm1(-2.0 * hazard * step)  # of a chain that changes at this rate either way
    return _both_ways(likely, change)


@compiled
def _both_ways(likely: Floats, change: Floats) -> Floats:
    n = len(change)
    forward, backward = np.empty((n, 2)), np.ones((n, 2))
    before = np.full(2, 0.5)
    for k in range(n):
        before = _stepped(before, change[k]) * likely[k]
        before = before / before.sum()
        forward[k] = before
    for k in range(n - 2, -1, -1):
        later = _stepped(backward[k + 1] * likely[k + 1], change[k + 1])
        backward[k] = later / later.sum()
    both = forward * backward
    return both[:, 1] / both.sum(axis=1)


@compiled
def _stepped(share: Floats, change: float) -> Floats:
    return np.array([share[0] + change * (share[1] - share[0]), share[1] + change * (share[0] - share[1])])
