"""Which part of a law's spread persists from ping to ping, and its estimate from a survey.

A law of single pings spreads over what it is not given: the actual position of the reflector, the sensor, the air. Of
two pings from the same place these are the same, so only a part of the spread is drawn anew. The law is sampled from
uniform numbers; each is Phi(sqrt(r) g + sqrt(1 - r) e) with a standard normal g that persists and an e drawn at every
ping (a Gaussian copula; Nelsen, "An Introduction to Copulas", section 2.3). A law that is sampled in this way keeps
its distribution at every single ping.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from acquisition import Ping, Reading
from acquisition.arrays import Bits, Floats, Ints
from acquisition.limits import PositiveMetres, Share, check_settings
from noise.law import EchoLaw

NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(64)  # of an average over g
MAX_SHARE = 0.999  # keeps the normal quantiles finite
MIN_PAIRS = 50
# Errors of four units of the rig (serial numbers from 401) along eight streets (seeds from 3,000,000), neither of them
# used elsewhere, correlate by 0.90 after 1 cm, 0.79 after 5 cm and 0.60 after 20 cm, of which the law's mean explains a
# part; these values give 0.87, 0.79 and 0.60. The length is about twelve wavelengths
LASTING, LENGTH_M = 0.7, 0.1


@dataclass(frozen=True)
class Persistence:
    """The persisting part of a law's spread.

    Attributes:
        detection: share of the variance of the number that decides on an echo, 0..1.
        range: share of the variance of the number that decides on the range, 0..1.
        lasting: share of the persisting part that does not change with movement, 0..1.
        length_m: correlation length of the other part, m of movement of the reflector relative to the sensor.
    """

    detection: Share
    range: Share
    lasting: Share = LASTING
    length_m: PositiveMetres = LENGTH_M

    def __post_init__(self) -> None:
        """Raise SettingError for invalid values."""
        check_settings(self)

    def to_dict(self) -> dict[str, float]:
        """Return plain data."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Any) -> Persistence | None:
        """Build from plain data; None for a law whose spread is drawn anew at every ping."""
        return None if data is None else cls(**{name: float(value) for name, value in data.items()})


def share_of_detection(probability: Floats, first: Bits, second: Bits) -> float:
    """Return the share r for which pairs of echoes are as frequent as observed.

    Args:
        probability: P(echo) by the law, of each pair of pings from one place, (n,).
        first: whether the first ping gave an echo, (n,).
        second: whether the second ping gave one, (n,).
    """
    bound = ndtri(np.clip(probability, 1e-9, 1.0 - 1e-9))[:, None]
    agree = float(np.mean(first == second))

    def excess(share: float) -> float:
        given = ndtr((bound - np.sqrt(share) * NODES) / np.sqrt(1.0 - share))
        same = (given**2 + (1.0 - given) ** 2) @ WEIGHTS / WEIGHTS.sum()
        return float(same.mean()) - agree

    if excess(0.0) >= 0.0:
        return 0.0
    return MAX_SHARE if excess(MAX_SHARE) <= 0.0 else float(brentq(excess, 0.0, MAX_SHARE))


def share_of_range(law: EchoLaw, first: Floats, second: Floats) -> float:
    """Return the correlation of the normal scores of two ranges from one place, given an echo.

    Args:
        law: law of the first and the second ping, (n,).
        first: range reading of the first ping, m, (n,).
        second: range reading of the second ping, m, (n,).
    """
    scores = []
    for reading in (first, second):
        step, echo = law.step(reading), np.maximum(law.echo, 1e-9)
        middle = 0.5 * (law.cdf_step(step - 1) + law.cdf_step(step)) / echo
        scores.append(ndtri(np.clip(middle, 1e-3, 1.0 - 1e-3)))
    return float(np.clip(np.corrcoef(scores[0], scores[1])[0, 1], 0.0, MAX_SHARE))


def survey_persistence(model: Any, ping: Ping, reading: Reading) -> Persistence | None:
    """Estimate the persisting shares from the first two pings of each visit of a survey; None with too few visits.

    How they decay with movement cannot be seen in visits; it is that of the rig.

    Args:
        model: a law of single pings.
        ping: conditions of a recording, (n,); a visit is a series of pings of one run with equal conditions.
        reading: readings, (n,).
    """
    first = _pairs(ping)
    if len(first) < MIN_PAIRS:
        return None
    law = model.law(ping[first])
    echo = reading.echo[first], reading.echo[first + 1]
    both = echo[0] & echo[1]
    pairs = first[both]
    ranged = model.law(ping[pairs])
    return Persistence(
        share_of_detection(law.echo, *echo),
        share_of_range(ranged, reading.range[pairs], reading.range[pairs + 1]),
    )


def _pairs(ping: Ping) -> Ints:
    """Return the first ping of each visit that is followed by another of the same visit."""
    condition = np.stack([ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.run.astype(np.float64)])
    same = np.all(condition[:, 1:] == condition[:, :-1], axis=0)
    begins = np.r_[True, ~same]
    return np.flatnonzero(begins[:-1] & same)
