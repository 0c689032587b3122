"""The law of all networks: a mixture of logistic components, a uniform component, no echo and no answer.

A `Head` defines the law by the outputs of a network, so that architectures differ only in how they compute them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit, logit

from acquisition import EchoStatus, Reading
from acquisition.limits import Limit, PositiveMetres, check_settings
from noise.law import EchoLaw, Floats, UniformSource
from noise.learned.inputs import FeatureBatch
from noise.schema import Resolution

FLOOR = 1e-5  # smallest probability of each outcome
# as integers, since looking up a member of an enum takes longer than drawing eight numbers
_NO_ECHO, _ECHO, _NO_ANSWER = (int(EchoStatus[name]) for name in ("NO_ECHO", "ECHO", "NO_ANSWER"))
UNIT_M = 0.01  # m; scale of the network's outputs for locations and widths
HALF_UNIFORM_EXCESS = 0.25  # excess at which half of the law is replaced by the uniform component and no echo
END_EXCESS = 1e-3  # excess that is none: conditions drawn from a range do not contain its ends
WIDENING = 10.0  # relative growth of the widths per unit of excess


class MixtureLaw(EchoLaw):
    """Logistic components, a uniform component over the whole range, no echo, and no answer.

    Attributes:
        share: probabilities of the components, the uniform component and no echo, given an answer, (C + 2, n).
        centre, scale: location and scale of the components, m, (C, n).
        answer_rate: probability of an answer, (n,) or scalar.
        excess: distance of each condition from the learned range, relative to its width, (n,).
        missing: whether a covariate of the model is missing, (n,) bool.
        outside: whether a covariate has a value with which the law was not trained, (n,) bool.
    """

    uniform_per_ping = True

    def __init__(
        self,
        batch: FeatureBatch,
        share: Floats,
        centre: Floats,
        scale: Floats,
        head: Head,
        answer_rate: Floats | float,
    ) -> None:
        super().__init__(batch.distance, head.resolution, head.max_range)
        self.share, self.centre, self.scale = share, centre, scale
        self.answer_rate = answer_rate
        self.excess, self.missing, self.outside = batch.excess, batch.missing, batch.outside

    @property
    def extrapolates(self) -> NDArray[np.bool_]:
        """Whether each condition, or a covariate, lies outside those of the training data, (n,) bool."""
        return (self.excess > END_EXCESS) | self.outside

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        return np.broadcast_to(1.0 - np.asarray(self.answer_rate), (len(self),))

    def _arrival(self, z: Floats) -> Floats:
        z = np.asarray(z, dtype=np.float64)
        peaks = (self.share[:-2] * expit((z[..., None, :] - self.centre) / self.scale)).sum(axis=-2)
        return self.answer_rate * (peaks + self.share[-2] * self._share_of_scale(z))

    def _between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high]), exact in the tails."""
        a, b = ((z[..., None, :] - self.centre) / self.scale for z in (low, high))
        wide = np.where(np.isinf(a) | np.isinf(b), np.inf, (high - low)[..., None, :] / self.scale)
        # s(b) - s(a) = s(b) s(-a) (1 - exp(a - b)) has no cancellation for any a and b
        peaks = (self.share[:-2] * np.exp(log_expit(b) + log_expit(-a)) * -np.expm1(-wide)).sum(axis=-2)
        return self.answer_rate * (peaks + self.share[-2] * (self._share_of_scale(high) - self._share_of_scale(low)))

    def _share_of_scale(self, z: Floats) -> Floats:
        return np.clip(z / self.max_range, 0.0, 1.0)

    def _sample(self, rng: UniformSource) -> Reading:
        """Draw a reading for each ping from two uniform numbers, for the outcome and for the range within it."""
        n, c = len(self), len(self.centre)
        which, where = rng.random((2, n))
        edges = self.answer_rate * self.share.cumsum(axis=0)
        edges[-1] = self.answer_rate  # exact, despite rounding of the sum
        outcome = (which >= edges).sum(axis=0)  # c: uniform, c + 1: no echo, c + 2: no answer
        peak = np.minimum(outcome, c - 1) * n + np.arange(n)
        from_peak = self.centre.ravel()[peak] + self.scale.ravel()[peak] * logit(where)
        place = np.where(outcome < c, from_peak, where * self.max_range)
        step = within(np.rint(place / self.resolution), 1, self.last_step)
        return Reading(np.where(outcome <= c, step * self.resolution, 0.0), _statuses(c)[outcome])


@lru_cache
def _statuses(components: int) -> NDArray[np.uint8]:
    """Return the status of each outcome of a mixture, (components + 3,)."""
    return np.array([_ECHO] * (components + 1) + [_NO_ECHO, _NO_ANSWER], dtype=np.uint8)


def within(x: Floats, low: Floats | float, high: Floats | float) -> Floats:
    """Return the same as `np.clip`, in half the time for small arrays."""
    return np.minimum(np.maximum(x, low), high)


@dataclass(frozen=True)
class Head:
    """Interpretation of a network's outputs as a law.

    The outputs are a logit of each component, of the uniform component and of no echo; with `fails`, one of no answer;
    then a location and a width of each component.

    Attributes:
        near: number of components about the true distance.
        fixed: number of components anywhere in the range.
        resolution: step of the register, m.
        max_range: range of the register's last step, m.
        no_answer: probability of no answer, if it is equal for all pings.
        anchored: number of components about earlier readings.
        fails: whether the network has an output for the probability of no answer.
    """

    near: Annotated[int, Limit(1, 1024)]
    fixed: Annotated[int, Limit(0, 1024)]
    resolution: Resolution
    max_range: PositiveMetres
    no_answer: Annotated[float, Limit(0.0, 1.0, open_high=True)] = 0.0
    anchored: Annotated[int, Limit(0, 1024)] = 0
    fails: bool = False

    def __post_init__(self) -> None:
        """Raise SettingError for invalid values."""
        check_settings(self)

    @property
    def components(self) -> int:
        """Number of logistic components."""
        return self.near + self.fixed + self.anchored

    @property
    def width(self) -> int:
        """Number of outputs of the network."""
        return 3 * self.components + 2 + self.fails

    def indices_of(self, simple: Head) -> NDArray[np.int64]:
        """Return the indices, among these outputs, of those of a head with the same near and fixed components only."""
        own = simple.near + simple.fixed
        logits = np.r_[0:own, self.components : self.components + 2]
        start = self.components + 2 + self.fails
        return np.r_[logits, start : start + own, start + self.components : start + self.components + own]

    def law(self, numbers: Floats, batch: FeatureBatch, anchors: Floats | None = None) -> MixtureLaw:
        """Return the law of n pings.

        Args:
            numbers: outputs of the network, (n, width).
            batch: features of the conditions.
            anchors: ranges about which the anchored components lie, m, (anchored, n).
        """
        c = self.components
        logit, place, width = numbers.T[: c + 2], numbers.T[-2 * c : -c], numbers.T[-c:]
        grown = np.exp(logit - logit.max(axis=0))  # scipy's softmax is slower for few pings
        share = FLOOR + (1.0 - FLOOR * len(logit)) * grown / grown.sum(axis=0)
        scale = 0.1 * self.resolution + UNIT_M * np.exp(within(width, -8.0, 6.0))
        if batch.excess.any():
            uniform = batch.excess / (batch.excess + HALF_UNIFORM_EXCESS)
            share *= 1.0 - uniform
            share[-2:] += 0.5 * uniform
            scale *= 1.0 + WIDENING * batch.excess
        rate = expit(-numbers.T[c + 2]) if self.fails else 1.0 - self.no_answer
        return MixtureLaw(batch, share, self._centres(place, batch.distance, anchors), scale, self, rate)

    def _centres(self, place: Floats, distance: Floats, anchors: Floats | None) -> Floats:
        near = distance + UNIT_M * np.sinh(within(place[: self.near], -7.0, 7.0))
        fixed = self.max_range * expit(place[self.near : self.near + self.fixed])
        if anchors is None:
            return np.concatenate([near, fixed])
        again = anchors + UNIT_M * np.sinh(within(place[self.near + self.fixed :], -7.0, 7.0))
        return np.concatenate([near, fixed, again])
