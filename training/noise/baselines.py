"""Baselines for noise models: fitted Gaussian, empirical law of each recorded condition, fitted physics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from acquisition import Ping, Reading, Recording
from noise.effects import CATALOGUE
from noise.fitting.fit import fit
from noise.law import EchoLaw, Floats
from noise.metrics import Evaluation, evaluate
from noise.model import MAX_RANGE, GaussianModel, IdealModel, SonarModel
from noise.physical import PhysicalModel
from training.noise.corpus import first_pings

# m, rad, rad, 1: differences of equal weight in the distance between conditions; project choice
CONDITION_SCALE = np.array([0.1, 0.05, 0.05, 0.5])
PRIOR_PINGS = 1.0  # weight of the smooth law, in pings of the condition; project choice
PHYSICS_START = {  # effects of the thesis's laboratory, and initial values of their fitted parameters
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
PINGS_PER_VISIT, ITERATIONS = 2, 80  # of the fit of the physics; further pings of a visit add little


def fit_gaussian(ping: Ping, reading: Reading, resolution: float, max_range: float) -> GaussianModel:
    """Return the maximum-likelihood `GaussianModel` of answered pings, as commonly used in simulators."""
    echo = reading.echo
    miss = float(np.clip(1.0 - echo.mean(), 0.0, 0.999))

    def model(x: NDArray[np.float64]) -> GaussianModel:
        sigma, per_metre = np.exp(np.clip(x, -20.0, 3.0))
        return GaussianModel(float(sigma), float(per_metre), miss, resolution, max_range)

    def loss(x: NDArray[np.float64]) -> float:
        return -float(np.maximum(model(x).law(ping[echo]).log_prob(reading[echo]), -1e3).mean())

    found = minimize(loss, np.log([0.03, 0.02]), method="Nelder-Mead", options={"xatol": 0.01, "fatol": 1e-4})
    return model(found.x)


def score(model: SonarModel, train: Recording, test: Recording) -> dict[str, Evaluation]:
    """Return the scores of a model and of simple baselines on new sensors."""
    answered = train.reading.answered
    gaussian = fit_gaussian(train.ping[answered], train.reading[answered], model.resolution, MAX_RANGE)
    baselines: dict[str, SonarModel] = {"ideal": IdealModel(model.resolution, MAX_RANGE), "Gaussian, fitted": gaussian}
    condition = np.unique(np.stack([test.run, test.condition]), axis=1, return_inverse=True)[1].ravel()
    return {k: evaluate(m, test.ping, test.reading, condition) for k, m in {**baselines, "network": model}.items()}


class NearestConditionLaw(EchoLaw):
    """Empirical error distribution of the nearest recorded condition, mixed with a smooth law."""

    def __init__(self, smooth: EchoLaw, model: NearestConditionModel, nearest: NDArray[np.int64]) -> None:
        super().__init__(smooth.distance, smooth.resolution, smooth.max_range)
        self.smooth, self.model, self.nearest = smooth, model, nearest
        self._weight = PRIOR_PINGS / (PRIOR_PINGS + model.pings[nearest])

    def _arrival(self, z: Floats) -> Floats:
        z = np.asarray(z, dtype=np.float64)
        error = np.broadcast_to(z - self.distance + 1e-9, z.shape)
        share = np.empty(z.shape)
        for condition in np.unique(self.nearest):
            rows = self.nearest == condition
            share[..., rows] = np.searchsorted(self.model.error[condition], error[..., rows], side="right")
        share /= self.model.pings[self.nearest]
        return (1.0 - self._weight) * share + self._weight * self.smooth._arrival(z)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,), from the smooth law."""
        return self.smooth.no_answer


@dataclass(frozen=True)
class NearestConditionModel:
    """Empirical law of each condition.

    Attributes:
        condition: distance, angle, incidence, reflectance of each, in units of `CONDITION_SCALE`, (conditions, 4).
        error: sorted range errors of the echoes in each condition, m.
        pings: number of answered pings in each condition, (conditions,).
        smooth: law of readings that were never recorded.
    """

    condition: Floats
    error: tuple[Floats, ...]
    pings: Floats
    smooth: SonarModel
    remembers: bool = False

    @classmethod
    def of(cls, recording: Recording, smooth: SonarModel) -> NearestConditionModel:
        """Collect the readings of each condition."""
        answered = recording.reading.answered
        ping, reading = recording.ping[answered], recording.reading[answered]
        _, condition = np.unique(recording.condition[answered], return_inverse=True)
        first = np.unique(condition, return_index=True)[1]
        error = reading.range - ping.distance
        each = tuple(np.sort(error[(condition == k) & reading.echo]) for k in range(len(first)))
        return cls(_scaled_condition(ping[first]), each, np.bincount(condition).astype(np.float64), smooth)

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.smooth.resolution

    def law(self, ping: Ping, past: Reading | None = None) -> NearestConditionLaw:
        """Return the law of n pings, each from the nearest recorded condition."""
        conditions, place = np.unique(_scaled_condition(ping), axis=0, return_inverse=True)
        nearest = np.array([np.argmin(np.abs(self.condition - one).sum(axis=1)) for one in conditions])
        return NearestConditionLaw(self.smooth.law(ping), self, nearest[place.ravel()])


def _scaled_condition(ping: Ping) -> Floats:
    return np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance], axis=1) / CONDITION_SCALE


def fit_physics(
    recording: Recording,
    max_range: float,
    start: Mapping[str, Mapping[str, float]] = PHYSICS_START,
    pings: int = PINGS_PER_VISIT,
) -> PhysicalModel:
    """Return a stack of effects for single pings with maximum-likelihood parameters.

    Args:
        recording: the data.
        max_range: range of the register's last step, m.
        start: effects, with initial values of the parameters to fit.
        pings: of each visit that are used.
    """
    stack = [CATALOGUE[name](**values) for name, values in start.items()]
    initial = PhysicalModel(stack, recording.resolution, max_range)
    some = recording.select(first_pings(recording, pings))
    free = [(name, parameter) for name, values in start.items() for parameter in values]
    return fit(initial, some, free, nuisances=False, iterations=ITERATIONS).stack.model
