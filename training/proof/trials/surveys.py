"""Which pings are fired in a trial: random conditions, in random order, with waits; and marginals that match."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import ks_2samp

from acquisition import Ping, Recording
from training.proof.trials.world import Rng, World

ANGLES_DEG = (-20.0, -10.0, -5.0, 0.0, 0.0, 5.0, 10.0, 20.0, 30.0)
MOVE_S = 20.0
PILOT_PINGS, CANDIDATES = 3, 6  # pings by which a condition is judged; conditions to choose from, a wanted one


@dataclass(frozen=True)
class Design:
    """How a survey is laid out.

    Attributes:
        cells, pings: number of conditions and of pings in each visit.
        runs: number of uninterrupted runs.
        turned: whether reflectors stay parallel to the sensor's face.
        interval_s: from ping to ping, drawn from a range once a survey.
        distance_m, angle_deg, reflectance: one value instead of a spread, where given.
    """

    cells: int = 72
    pings: int = 15
    runs: int = 3
    turned: bool = False
    interval_s: tuple[float, float] = (0.1, 0.1)
    distance_m: float | None = None
    angle_deg: float | None = None
    reflectance: float | None = None

    def conditions(self, rng: Rng, n: int | None = None) -> Ping:
        """Draw conditions, (n,); as many as there are cells by default."""
        n = self.cells if n is None else n
        distance = np.round(np.exp(rng.uniform(np.log(0.25), np.log(3.5), n)), 3)
        angle = np.deg2rad(rng.choice(ANGLES_DEG, n))
        reflectance = rng.choice([0.1, 0.9], n)
        if self.distance_m is not None:
            distance = np.full(n, self.distance_m)
        if self.angle_deg is not None:
            angle = np.full(n, np.deg2rad(self.angle_deg))
        if self.reflectance is not None:
            reflectance = np.full(n, self.reflectance)
        incidence = angle if self.turned else np.zeros(n)
        return Ping.of(distance=distance, angle=angle, incidence=incidence, reflectance=reflectance)

    def survey(self, cells: Ping, rng: Rng) -> Ping:
        """Return the pings of a survey of conditions, each visited once, in random order."""
        order = np.repeat(rng.permutation(len(cells)), self.pings)
        wait = rng.uniform(*self.interval_s, len(order))
        wait[:: self.pings] = MOVE_S
        run = np.repeat(np.arange(self.runs), -(-len(order) // self.runs))[: len(order)]
        return replace(cells[order], time=np.round(np.cumsum(wait) - wait[0], 3), run=run)


def matching(design: Design, wanted: Recording, world: World, rng: Rng) -> Ping:
    """Return conditions under which a world's readings, pooled, look like those of a recording.

    A pilot of a few pings in each of many conditions tells what is read there; each condition of the recording gets
    the one that is nearest in mean reading and in share of echoes, all at once.
    """
    cells = design.conditions(rng, CANDIDATES * design.cells)
    pilot = world.record(replace(design, pings=PILOT_PINGS).survey(cells, rng), rng)
    there = _features(pilot)
    target = _features(wanted)
    cost = np.abs(target[:, None, :] - there[None, :, :]).sum(axis=2)
    chosen = linear_sum_assignment(cost)[1]
    first = np.unique(pilot.condition, return_index=True)[1]
    ping = pilot.ping[first[chosen]]
    return Ping(ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.time, ping.run, {})


def _features(recording: Recording) -> np.ndarray:
    """Return mean echo, m, and share of echoes, weighted, of each condition, (cells, 2)."""
    echo, count = recording.reading.echo, np.bincount(recording.condition)
    heard = np.bincount(recording.condition, echo)
    mean = np.bincount(recording.condition, np.where(echo, recording.reading.range, 0.0)) / np.maximum(heard, 1)
    return np.stack([mean, 3.0 * heard / count], axis=1)


def marginals(simulated: Recording, recorded: Recording) -> dict[str, float]:
    """Return how alike the pooled readings of two recordings are: Kolmogorov-Smirnov over conditions, mean, spread."""
    first, second = (_features(r) for r in (simulated, recorded))
    echoes = [f[f[:, 1] > 1.5, 0] for f in (first, second)]
    return {
        "ks_p": float(ks_2samp(echoes[0], echoes[1], method="asymp").pvalue),
        "mean_mm": 1000.0 * float(echoes[1].mean() - echoes[0].mean()),
        "sd_ratio": float(echoes[1].std() / echoes[0].std()),
        "silent": float((first[:, 1].mean() - second[:, 1].mean()) / 3.0),
    }
