"""What noise models are compared with: the scatter of simulators, conditions as they were recorded, fitted physics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from acquisition import Ping, Reading, Recording
from noise.effects import CATALOGUE
from noise.fitting.fit import fit
from noise.law import EchoLaw, Floats
from noise.model import GaussianModel, SonarModel
from noise.physical import PhysicalModel
from training.noise.corpus import thinned

# how different two conditions are: m, rad, rad, 1 that weigh alike; ours
ALIKE = np.array([0.1, 0.05, 0.05, 0.5])
PRIOR_PINGS = 1.0  # weight of the smooth law against a condition's own pings; ours
PHYSICS = {  # a stack with everything that the thesis's laboratory shows, what of it is fitted, and from where
    "sensitivity": {"loss_db": 30.0},
    "scintillation": {"sigma_at_6m_db": 2.0},
    "beam_width": {"ka": 4.8},
    "specular_loss": {"strength": 0.5},
    "background_reflector": {"presence": 0.5, "behind_m": 0.3, "loss_db": 19.0},
    "time_walk": {"scale": 1.0},
    "travel_time_jitter": {"sigma_m": 0.008, "per_metre": 0.004},
    "zero_offset": {"offset_m": -0.01},
    "spike": {"probability": 0.01},
    "dropped_reading": {"probability": 0.02},
}
PINGS_A_VISIT, ITERATIONS = 2, 80  # that the physics is fitted to; pings of one visit tell little more


def fit_gaussian(ping: Ping, reading: Reading, resolution: float, max_range: float) -> GaussianModel:
    """Return the most likely `GaussianModel` of answered pings: what is usually put in a simulator."""
    echo = reading.echo
    miss = float(np.clip(1.0 - echo.mean(), 0.0, 0.999))

    def model(x: NDArray[np.float64]) -> GaussianModel:
        sigma, per_metre = np.exp(np.clip(x, -20.0, 3.0))
        return GaussianModel(float(sigma), float(per_metre), miss, resolution, max_range)

    def loss(x: NDArray[np.float64]) -> float:
        return -float(np.maximum(model(x).law(ping[echo]).log_prob(reading[echo]), -1e3).mean())

    found = minimize(loss, np.log([0.03, 0.02]), method="Nelder-Mead", options={"xatol": 0.01, "fatol": 1e-4})
    return model(found.x)


class CellLaw(EchoLaw):
    """What was read in the nearest condition recorded, moved along with the distance; a smooth law where it ends."""

    def __init__(self, smooth: EchoLaw, model: CellModel, place: NDArray[np.int64]) -> None:
        super().__init__(smooth.distance, smooth.resolution, smooth.max_range)
        self.smooth, self.model, self.place = smooth, model, place
        self._weight = PRIOR_PINGS / (PRIOR_PINGS + model.pings[place])

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        z = np.asarray(z, dtype=np.float64)
        off = np.broadcast_to(z - self.distance + 1e-9, z.shape)
        share = np.empty(z.shape)
        for cell in np.unique(self.place):
            rows = self.place == cell
            share[..., rows] = np.searchsorted(self.model.off[cell], off[..., rows], side="right")
        share /= self.model.pings[self.place]
        return (1.0 - self._weight) * share + self._weight * self.smooth.arrival(z)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,): the smooth law's."""
        return self.smooth.no_answer


@dataclass(frozen=True)
class CellModel:
    """The empirical law of each condition.

    Attributes:
        condition: distance, angle, incidence, reflectance of each, in units of `ALIKE`, (cells, 4).
        off: by how much each echo in it read too far, sorted, m.
        pings: answered, in each, (cells,).
        smooth: law of what was never read.
    """

    condition: Floats
    off: tuple[Floats, ...]
    pings: Floats
    smooth: SonarModel
    remembers: bool = False

    @classmethod
    def of(cls, recording: Recording, smooth: SonarModel) -> CellModel:
        """Collect the readings of each condition."""
        answered = recording.reading.answered
        ping, reading = recording.ping[answered], recording.reading[answered]
        _, cell = np.unique(recording.condition[answered], return_inverse=True)
        first = np.unique(cell, return_index=True)[1]
        off = reading.range - ping.distance
        each = tuple(np.sort(off[(cell == k) & reading.echo]) for k in range(len(first)))
        return cls(_condition(ping[first]), each, np.bincount(cell).astype(np.float64), smooth)

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.smooth.resolution

    def law(self, ping: Ping, past: Reading | None = None) -> CellLaw:
        """Return the law of n pings, each that of the condition nearest to its own."""
        asked, place = np.unique(_condition(ping), axis=0, return_inverse=True)
        nearest = np.array([np.argmin(np.abs(self.condition - one).sum(axis=1)) for one in asked])
        return CellLaw(self.smooth.law(ping), self, nearest[place.ravel()])


def _condition(ping: Ping) -> Floats:
    return np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance], axis=1) / ALIKE


def fit_physics(recording: Recording, max_range: float) -> PhysicalModel:
    """Return the most likely parameters of a stack of effects for single pings."""
    stack = [CATALOGUE[name](**values) for name, values in PHYSICS.items()]
    start = PhysicalModel(stack, recording.resolution, max_range)
    some = recording.select(thinned(recording, PINGS_A_VISIT))
    free = [(name, parameter) for name, values in PHYSICS.items() for parameter in values]
    return fit(start, some, free, nuisances=False, iterations=ITERATIONS).stack.model
