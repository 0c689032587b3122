"""The law that every network speaks: logistic components, one uniform over the scale, silence, no answer.

A `Head` reads it from a network's last numbers, so architectures differ only in how they come to those numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit, logit

from acquisition import EchoStatus, Reading, SettingError
from noise.law import EchoLaw, Floats
from noise.learned.inputs import Asked

FLOOR = 1e-5  # least share of each outcome: a network is never certain
# looking a member up costs more than drawing eight numbers
_NO_ECHO, _ECHO, _NO_ANSWER = (int(EchoStatus[name]) for name in ("NO_ECHO", "ECHO", "NO_ANSWER"))
UNIT_M = 0.01  # m; scale of the network's numbers for places and widths
HALF_IGNORANT = 0.25  # excess at which half of the law is ignorance
WIDENING = 10.0  # growth of every width per unit of excess


class MixtureLaw(EchoLaw):
    """Logistic components, one uniform over the scale, silence, and no answer.

    Attributes:
        share: probabilities of the components, the uniform, silence, given an answer, (C + 2, n).
        centre, scale: of the components, m, (C, n).
        answer_rate: probability of an answer, (n,) or one for all.
        excess: how far each condition lies outside what was learned, in widths of the learned range, (n,).
        missing: where a covariate that the model knows of was not given, (n,) bool.
    """

    def __init__(
        self,
        asked: Asked,
        share: Floats,
        centre: Floats,
        scale: Floats,
        head: Head,
        answer_rate: Floats | float,
    ) -> None:
        super().__init__(asked.distance, head.resolution, head.max_range)
        self.share, self.centre, self.scale = share, centre, scale
        self.answer_rate = answer_rate
        self.excess, self.missing = asked.excess, asked.missing

    @property
    def extrapolated(self) -> NDArray[np.bool_]:
        """Where the law is asked outside what was learned, (n,) bool."""
        return self.excess > 0

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        return np.broadcast_to(1.0 - np.asarray(self.answer_rate), (len(self),))

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        z = np.asarray(z, dtype=np.float64)
        peaks = (self.share[:-2] * expit((z[..., None, :] - self.centre) / self.scale)).sum(axis=-2)
        return self.answer_rate * (peaks + self.share[-2] * self._share_of_scale(z))

    def between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high]), exact in the tails."""
        a, b = ((z[..., None, :] - self.centre) / self.scale for z in (low, high))
        wide = np.where(np.isinf(a) | np.isinf(b), np.inf, (high - low)[..., None, :] / self.scale)
        # s(b) - s(a) = s(b) s(-a) (1 - exp(a - b)) holds without loss wherever a and b lie
        peaks = (self.share[:-2] * np.exp(log_expit(b) + log_expit(-a)) * -np.expm1(-wide)).sum(axis=-2)
        return self.answer_rate * (peaks + self.share[-2] * (self._share_of_scale(high) - self._share_of_scale(low)))

    def _share_of_scale(self, z: Floats) -> Floats:
        return np.clip(z / self.max_range, 0.0, 1.0)

    def sample(self, rng: np.random.Generator) -> Reading:
        """Draw a reading for each ping: one number picks the outcome, one the place within it."""
        n, c = len(self), len(self.centre)
        which, where = rng.random((2, n))
        edges = self.answer_rate * self.share.cumsum(axis=0)
        edges[-1] = self.answer_rate  # whatever the shares' sum is rounded to
        outcome = (which >= edges).sum(axis=0)  # c: the uniform, c + 1: silence, c + 2: no answer
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
    """Return `np.clip`, in half its time for a few numbers."""
    return np.minimum(np.maximum(x, low), high)


@dataclass(frozen=True)
class Head:
    """How a network's last numbers are read as a law.

    The numbers: a logit of each component, of the uniform and of silence; where `fails`, one of no answer; then a place
    and a width of each component.

    Attributes:
        near: components placed about the true distance.
        fixed: components placed anywhere on the scale.
        resolution: step of the register, m.
        max_range: of the register, m.
        no_answer: rate at which the sensor does not answer, where that is the same for every ping.
        anchored: components placed about readings that were heard before.
        fails: whether the network says how likely no answer is.
    """

    near: int
    fixed: int
    resolution: float
    max_range: float
    no_answer: float = 0.0
    anchored: int = 0
    fails: bool = False

    def __post_init__(self) -> None:
        """Refuse what is no mixture."""
        if self.near < 1 or self.fixed < 0 or self.anchored < 0:
            raise SettingError(f"Head needs at least one near component, got {self.near} near and {self.fixed} fixed")
        if not 0 <= self.no_answer < 1:
            raise SettingError(f"Head.no_answer must lie in [0, 1), got {self.no_answer:g}")

    @property
    def components(self) -> int:
        """Number of logistic components."""
        return self.near + self.fixed + self.anchored

    @property
    def width(self) -> int:
        """How many numbers a network must give a ping."""
        return 3 * self.components + 2 + self.fails

    def places_of(self, simple: Head) -> NDArray[np.int64]:
        """Return where the numbers of a head with the same near and fixed components stand among this one's."""
        own = simple.near + simple.fixed
        logits = np.r_[0:own, self.components : self.components + 2]
        start = self.components + 2 + self.fails
        return np.r_[logits, start : start + own, start + self.components : start + self.components + own]

    def law(self, numbers: Floats, asked: Asked, anchors: Floats | None = None) -> MixtureLaw:
        """Return the law of n pings from a network's numbers, (n, width).

        Args:
            numbers: of the network.
            asked: of which conditions.
            anchors: ranges about which the anchored components lie, m, (anchored, n).
        """
        c = self.components
        logit, place, width = numbers.T[: c + 2], numbers.T[-2 * c : -c], numbers.T[-c:]
        grown = np.exp(logit - logit.max(axis=0))  # scipy's softmax takes longer than all the rest for a few pings
        share = FLOOR + (1.0 - FLOOR * len(logit)) * grown / grown.sum(axis=0)
        scale = 0.1 * self.resolution + UNIT_M * np.exp(within(width, -8.0, 6.0))
        if asked.excess.any():
            ignorance = asked.excess / (asked.excess + HALF_IGNORANT)
            share *= 1.0 - ignorance
            share[-2:] += 0.5 * ignorance
            scale *= 1.0 + WIDENING * asked.excess
        rate = expit(-numbers.T[c + 2]) if self.fails else 1.0 - self.no_answer
        return MixtureLaw(asked, share, self._centres(place, asked.distance, anchors), scale, self, rate)

    def _centres(self, place: Floats, distance: Floats, anchors: Floats | None) -> Floats:
        near = distance + UNIT_M * np.sinh(within(place[: self.near], -7.0, 7.0))
        fixed = self.max_range * expit(place[self.near : self.near + self.fixed])
        if anchors is None:
            return np.concatenate([near, fixed])
        again = anchors + UNIT_M * np.sinh(within(place[self.near + self.fixed :], -7.0, 7.0))
        return np.concatenate([near, fixed, again])
