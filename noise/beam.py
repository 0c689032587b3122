"""The beam model of Thrun, Burgard and Fox (Probabilistic Robotics, 2005, section 6.3), and its fit.

A reading comes from one of four components: a hit, normal about the true distance; an unexpected object, exponential
and truncated at the true distance; a maximum-range reading, which a sonar reports as no echo; or a uniform random one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from acquisition import Ping, Reading, SettingError
from acquisition.arguments import checked
from acquisition.limits import Limit, PositiveMetres, Share, check_settings
from noise.law import EchoLaw, Floats
from noise.model import MAX_RANGE, from_numbers, plain_numbers
from noise.schema import Resolution

MIN_SIGMA = 1e-3  # m; keeps the likelihood of a hit bounded
TINY = 1e-300


class BeamLaw(EchoLaw):
    """The law of n pings under a `BeamModel`."""

    def __init__(self, distance: Floats, model: BeamModel) -> None:
        super().__init__(distance, model.resolution, model.max_range)
        self.model = model

    def parts(self, low: Floats, high: Floats) -> Floats:
        """Return P(exact range in (low, high] | hit, short, random), (3, ..., n)."""
        model = self.model
        with np.errstate(over="ignore"):  # an infinite number of deviations is one, too
            below, above = (low - self.distance) / model.sigma, (high - self.distance) / model.sigma
        hit = np.where(below > 0, ndtr(-below) - ndtr(-above), ndtr(above) - ndtr(below))
        return np.stack([hit, self._short(high) - self._short(low), self._anywhere(high) - self._anywhere(low)])

    def _short(self, z: Floats) -> Floats:
        rate, reach = max(self.model.short_rate, TINY), np.maximum(self.distance, self.resolution)
        return -np.expm1(-rate * np.clip(z, 0.0, reach)) / -np.expm1(-rate * reach)

    def _anywhere(self, z: Floats) -> Floats:
        return np.clip(z / self.max_range, 0.0, 1.0)

    def _between(self, low: Floats, high: Floats) -> Floats:
        return np.tensordot(self.model.echo_weights, self.parts(low, high), axes=1)

    def _arrival(self, z: Floats) -> Floats:
        z = np.asarray(z, dtype=np.float64)
        return self._between(np.full(z.shape, -np.inf), z)

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer): 0."""
        return np.zeros(len(self))


@dataclass(frozen=True)
class BeamModel:
    """A mixture of four components, with equal parameters at all distances and angles.

    Args:
        hit, short, silent, random: probabilities of the components; they sum to one.
        sigma: standard deviation of a hit, m.
        short_rate: rate of the exponential component, 1/m.
        resolution: step of the register, m.
        max_range: range of the register's last step, m.
    """

    hit: Share = 0.8
    short: Share = 0.05
    silent: Share = 0.1
    random: Share = 0.05
    sigma: PositiveMetres = 0.05
    short_rate: Annotated[float, Limit(0.0, 1e6, "1/m", open_low=True)] = 1.0
    resolution: Resolution = 0.001
    max_range: PositiveMetres = MAX_RANGE
    remembers: bool = False

    def __post_init__(self) -> None:
        """Raise SettingError for invalid values."""
        weights = (self.hit, self.short, self.silent, self.random)
        check_settings(self)
        if abs(sum(weights) - 1.0) > 1e-9:
            raise SettingError(f"BeamModel: hit, short, silent and random must sum to 1, got {weights}")

    @property
    def echo_weights(self) -> Floats:
        """Probabilities of hit, short and random, (3,)."""
        return np.array([self.hit, self.short, self.random])

    @checked
    def law(self, ping: Ping, past: Reading | None = None) -> BeamLaw:
        """Return the law of n pings."""
        return BeamLaw(ping.distance, self)

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain data."""
        return plain_numbers("beam", self)

    @classmethod
    @checked
    def from_dict(cls, data: dict[str, Any]) -> BeamModel:
        """Build a model from the output of `to_dict`.

        Raises:
            ModelError: a parameter is missing or not a number.
        """
        return from_numbers("beam", cls, data)


def fit_beam(
    ping: Ping, reading: Reading, resolution: float, max_range: float, iterations: int = 200, enough: float = 1e-6
) -> tuple[BeamModel, list[float]]:
    """Fit by expectation maximisation (Thrun's `learn_intrinsic_parameters`) on the steps of the register.

    Args:
        ping: conditions, (n,).
        reading: answered readings, (n,).
        resolution: step of the register, m.
        max_range: range of the register's last step, m.
        iterations: maximum number of iterations.
        enough: fitting stops when an iteration gains less, nats per ping.

    Returns:
        The model, and the mean log-likelihood before each iteration, nats per ping.
    """
    if not len(ping) or not reading.answered.all():
        raise SettingError("fit_beam needs at least one ping and an answer to each: remove pings without an answer")
    model, course = BeamModel(resolution=resolution, max_range=max_range), []
    for _ in range(iterations):
        share, likelihood = _responsibilities(model, ping, reading)
        course.append(float(np.log(np.maximum(likelihood, TINY)).mean()))
        if len(course) > 1 and course[-1] - course[-2] < enough:
            break
        model = _updated(model, ping, reading, share)
    return model, course


def _responsibilities(model: BeamModel, ping: Ping, reading: Reading) -> tuple[Floats, Floats]:
    """Return P(hit, short, random | reading), (3, n), 0 without an echo; and the likelihood of each reading, (n,)."""
    law = model.law(ping)
    step = law.step(reading.range)
    joint = model.echo_weights[:, None] * law.parts(law.edge(step - 1), law.edge(step)) * reading.echo
    likelihood = np.where(reading.echo, joint.sum(axis=0), model.silent)
    return joint / np.maximum(joint.sum(axis=0), TINY), likelihood


def _updated(model: BeamModel, ping: Ping, reading: Reading, share: Floats) -> BeamModel:
    hit, short, random = share.sum(axis=1) / len(ping)
    silent = max(1.0 - hit - short - random, 0.0)  # the sum may exceed 1 by rounding
    off = reading.range - ping.distance
    sigma = np.sqrt(_mean(off**2, share[0], model.sigma**2))
    rate = 1.0 / max(_mean(reading.range, share[1], 1.0 / model.short_rate), model.resolution)
    return replace(
        model,
        hit=float(hit), short=float(short), silent=float(silent), random=float(random),
        sigma=max(float(sigma), MIN_SIGMA), short_rate=float(rate),
    )  # fmt: skip


def _mean(value: Floats, weight: NDArray[np.float64], otherwise: float) -> float:
    total = float(weight.sum())
    return float((value * weight).sum()) / total if total > 1e-9 else otherwise
