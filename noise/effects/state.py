"""The state of a physical law, on which effects act: conditions, paths, clutter and replacements.

Everything is torch, float64 and differentiable in the parameters of the effects. Shapes: n pings; Q nodes of a latent
level shared by all paths of one ping (Q = 1 without fading); J detection points of a path.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from acquisition import EchoStatus, Ping, Reading
from acquisition.arrays import Floats
from acquisition.ping import RANGE_RATE, check_pairs

MARGIN_DB = 60.0  # level of a flat wall at 1 m above the threshold of an ideal sonar: no misses; chosen here
DETECTION_WIDTH_DB = 1.5  # spread of the level at the threshold: log-normal level noise, sigma 1.5 dB
MIN_SPREAD_M = 1e-6  # smallest standard deviation of an arrival, m: far below any register step
LAG_STEP_S = 0.05
LAGS_S: Floats = LAG_STEP_S * np.arange(21.0)  # up to 1 s, the longest delay
MAX_GAP_S = 0.5  # between pings of a log; over a longer one it does not tell where the sensor was; chosen here


@dataclass(frozen=True)
class Conditions:
    """A batch of pings as tensors, (n,) each; see `acquisition.Ping` for the meanings.

    Attributes:
        earlier: distance, angle and incidence some times before each ping, (3, lags, n); see `earlier`.
    """

    distance: Tensor
    angle: Tensor
    incidence: Tensor
    reflectance: Tensor
    time: Tensor
    run: Tensor
    past_range: Tensor
    past_status: Tensor
    covariates: Mapping[str, Tensor] = field(default_factory=dict)
    earlier: Tensor | None = None

    @classmethod
    def of(cls, ping: Ping, past: Reading | None = None) -> Conditions:
        """Convert arrays; without `past` the previous readings are unknown."""
        check_pairs("past", ping, past)
        n, before = len(ping), earlier(ping)
        tensor = torch.tensor  # copies, since arrays from a table may be read-only
        return cls(
            distance=tensor(ping.distance),
            angle=tensor(ping.angle),
            incidence=tensor(ping.incidence),
            reflectance=tensor(ping.reflectance),
            time=tensor(ping.time),
            run=tensor(ping.run),
            past_range=torch.zeros(n, dtype=torch.float64) if past is None else tensor(past.range),
            past_status=torch.full((n,), int(EchoStatus.NO_ANSWER)) if past is None else tensor(past.status).long(),
            covariates={name: tensor(value) for name, value in ping.covariates.items()},
            earlier=None if before is None else tensor(before),
        )


def earlier(ping: Ping) -> Floats | None:
    """Return distance, m, angle and incidence, rad, a time of `LAGS_S` before each ping, (3, lags, n).

    They are interpolated in the log of the run. Before its beginning and within long gaps, the distance follows from
    its rate, and the angles are those of the ping itself. None where no rate is known, or the pings of a run are not in
    the order of time.
    """
    rate = ping.covariates.get(RANGE_RATE)
    if rate is None or not _is_log(ping):
        return None
    now = np.stack([ping.distance, ping.angle, ping.incidence])
    out = np.repeat(now[:, None], len(LAGS_S), axis=1)
    out[0] = np.maximum(out[0] - LAGS_S[:, None] * rate, 0.0)
    for run in np.unique(ping.run):
        rows = np.flatnonzero(ping.run == run)
        time, then = ping.time[rows], ping.time[rows] - LAGS_S[:, None]
        after = np.clip(np.searchsorted(time, then), 1, len(rows) - 1)
        known = (then >= time[0]) & (time[after] - time[after - 1] <= MAX_GAP_S)
        for column, values in enumerate(now):
            inside = np.interp(then, time, values[rows])
            out[column][:, rows] = np.where(known, inside, out[column][:, rows])
    return out


def _is_log(ping: Ping) -> bool:
    """Return whether times ascend from ping to ping in each run, which lies in one piece."""
    same = ping.run[1:] == ping.run[:-1]
    pieces = 1 + int((~same).sum())
    return len(ping) > 1 and pieces == len(np.unique(ping.run)) and bool((np.diff(ping.time)[same] > 0).all())


@dataclass(frozen=True)
class Later:
    """What a receiver reads that misses a loud echo: the same at another range.

    Attributes:
        probability: that the echo is missed and read so.
        factor: on its range.
        extra: added to it, m, (n,) or scalar.
    """

    probability: Tensor
    factor: float
    extra: Tensor


@dataclass(frozen=True)
class Path:
    """A propagation path from the sensor back to it.

    Attributes:
        name: "direct", "background", ...
        length: half the length of the path, m, (n,).
        level_db: level above the threshold, dB, (Q, n).
        presence: probability that the path exists, (n,) or scalar.
        lag: delay of the detection after the arrival, as range, m, (Q, n) or scalar.
        spread: standard deviation of the arrival, m, (n,) or scalar.
        slip_m: offsets of the possible detection points, m, (J,).
        slip_weight: probabilities of the detection points, (J,).
        bearing: angle of departure and arrival off the beam axis, rad, (n,) or scalar.
        later: what is read where the receiver misses this echo.
        walk: how much later it is detected for each dB less of its level, m/dB, (n,) or scalar.
    """

    name: str
    length: Tensor
    level_db: Tensor
    presence: Tensor
    lag: Tensor
    spread: Tensor
    slip_m: Tensor
    slip_weight: Tensor
    bearing: Tensor
    later: tuple[Later, ...] = field(default=(), kw_only=True)
    walk: Tensor = field(default_factory=lambda: number(0.0), kw_only=True)

    def detection(self, width_db: Tensor) -> Tensor:
        """Return the probability that this path crosses the threshold, (Q, n)."""
        return self.presence * ndtr(self.level_db / width_db)

    def missing(self, width_db: Tensor) -> Tensor:
        """Return the probability that this path does not cross the threshold, exact where that is rare, (Q, n)."""
        return (1.0 - self.presence) + self.presence * ndtr(-self.level_db / width_db)

    def survival(self, z: Tensor) -> Tensor:
        """Return the survival function P(registered beyond z | detected)."""
        return self._with_later(self._survival, z)

    def between(self, low: Tensor, high: Tensor) -> Tensor:
        """Return P(registered in (low, high] | detected), exact in both tails."""
        return self._with_later(self._between, low, high)

    def _with_later(self, probability: Callable[..., Tensor], *z: Tensor) -> Tensor:
        """Return a probability of ranges, of which some are those of later echoes."""
        out = probability(*z)
        for each in self.later:
            moved = probability(*((edge - each.extra) / each.factor for edge in z))
            out = (1.0 - each.probability) * out + each.probability * moved
        return out

    def widened(self, variance: Tensor) -> Path:
        """Return the path with a variance, m^2, added to that of the arrival."""
        # sqrt has no derivative at 0: the small constant keeps gradients finite and is subtracted again
        return replace(self, spread=torch.sqrt(self.spread**2 + variance + 1e-18) - 1e-9)

    def missed(self, later: Later) -> Path:
        """Return the path with one more echo that is read in its place."""
        return replace(self, later=(*self.later, later))

    def _survival(self, z: Tensor) -> Tensor:
        return self._over_slips(ndtr(-self._scores(z)))

    def _between(self, low: Tensor, high: Tensor) -> Tensor:
        return self._over_slips(_normal_between(self._scores(low), self._scores(high)))

    def _scores(self, z: Tensor) -> Tensor:
        """Return the standardised distance of a range beyond each detection point, (J, ..., n)."""
        beyond = z - self._arrival
        return (beyond - self.slip_m.reshape(-1, *[1] * beyond.ndim)) / self._sigma

    @cached_property
    def _arrival(self) -> Tensor:
        return self.length + self.lag

    @cached_property
    def _sigma(self) -> Tensor:
        return torch.sqrt(self.spread**2 + MIN_SPREAD_M**2)

    def _over_slips(self, value: Tensor) -> Tensor:
        """Return the mean over detection points of (J, ..., n)."""
        return (self.slip_weight.reshape(-1, *[1] * (value.ndim - 1)) * value).sum(0)


def ndtr(score: Tensor) -> Tensor:
    """Return the normal cdf, exact in the lower tail, where `torch.special.ndtr`, (1 + erf) / 2, is 0 below -8."""
    return 0.5 * torch.erfc(score * -math.sqrt(0.5))


def interpolate(x: Tensor, at: tuple[float, ...], values: tuple[float, ...]) -> Tensor:
    """Return a piecewise linear function, constant beyond its ends and differentiable in x."""
    knots, heights = number(list(at)), number(list(values))
    inside = torch.clamp(x, at[0], at[-1])
    k = torch.clamp(torch.searchsorted(knots, inside.detach().contiguous()), 1, len(at) - 1)
    share = (inside - knots[k - 1]) / (knots[k] - knots[k - 1])
    return heights[k - 1] + share * (heights[k] - heights[k - 1])


def _normal_between(low: Tensor, high: Tensor) -> Tensor:
    """Return Phi(high) - Phi(low), computed in the tail where both are small."""
    sign = torch.where(low + high > 0, -1.0, 1.0)
    return sign * (ndtr(sign * high) - ndtr(sign * low))


@dataclass(frozen=True)
class Atom:
    """A distribution that replaces the reading with some probability.

    Attributes:
        weight: probability of the replacement, (n,) or scalar.
        cdf: P(echo, register <= edge) for register edges in m, (..., n).
        no_echo: P(no echo), (n,) or scalar.
        no_answer: P(no answer), (n,) or scalar.
        of_echo: whether it replaces echoes only; `cdf` is then that of a reading that is an echo.
    """

    weight: Tensor
    cdf: Callable[[Tensor], Tensor]
    no_echo: Tensor
    no_answer: Tensor
    of_echo: bool = False


@dataclass(frozen=True)
class Clutter:
    """False detections during the listening window.

    Attributes:
        per_metre: rate of false detections in pings with noise, 1/m.
        share: share of pings with noise.
        begins: exact range from which false detections occur, m.
    """

    per_metre: Tensor
    share: Tensor
    begins: Tensor

    def survival(self, z: Tensor, blind_range: Tensor | None) -> Tensor:
        """Return P(no false detection before an exact range z), given the receiver's blind range, if any."""
        begins = self.begins if blind_range is None else torch.maximum(self.begins, blind_range)
        return 1.0 + self.share * torch.expm1(-self.per_metre * torch.clamp(z - begins, min=0.0))


@dataclass(frozen=True)
class State:
    """All quantities that define a physical law; effects replace some of them.

    Attributes:
        conditions: conditions of the pings after mounting effects.
        paths: propagation paths; the first is the direct one.
        log_weight: log weights of the nodes of the latent level, (Q, 1).
        width_db: spread of the level at the threshold, dB.
        scale, offset: register = scale * exact range + offset (1 and m).
        gate: end of the listening window as exact range, m.
        clutter: false detections; None for none.
        step: rounding step of the register beyond its resolution, m; 0 for none.
        blind_range: exact range below which arrivals are not registered, m; None for none.
        atoms: replacements, applied in order.
    """

    conditions: Conditions
    paths: tuple[Path, ...]
    log_weight: Tensor
    width_db: Tensor
    scale: Tensor
    offset: Tensor
    gate: Tensor
    clutter: Clutter | None = None
    step: float = 0.0
    blind_range: Tensor | None = None
    atoms: tuple[Atom, ...] = ()

    @property
    def direct(self) -> Path:
        """The direct path to the reflector."""
        return self.paths[0]

    def with_direct(self, path: Path) -> State:
        """Replace the direct path."""
        return replace(self, paths=(path, *self.paths[1:]))

    def facing(self, conditions: Conditions) -> State:
        """Replace the conditions and the direct path that follows from them."""
        return replace(self, conditions=conditions, paths=(direct_path(conditions), *self.paths[1:]))

    def with_path(self, path: Path) -> State:
        """Add a path."""
        return replace(self, paths=(*self.paths, path))

    def map_paths(self, change: Callable[[Path], Path]) -> State:
        """Apply a change to every path."""
        return replace(self, paths=tuple(change(path) for path in self.paths))

    def with_atom(self, atom: Atom) -> State:
        """Add a replacement."""
        return replace(self, atoms=(*self.atoms, atom))


def number(value: float | list[float] | Tensor) -> Tensor:
    """Return a float64 tensor; tensors keep their gradient graph."""
    return torch.as_tensor(value, dtype=torch.float64)


def wall_level_db(length: Tensor) -> Tensor:
    """Return the level of a flat wall above the threshold of an ideal sonar, dB; its amplitude falls as 1/(2d)."""
    return MARGIN_DB - 20.0 / math.log(10.0) * torch.log(torch.clamp(length, min=0.01))


def heard_level_db(length: Tensor) -> Tensor:
    """Return the level of what is heard whenever it is present, dB: that of a wall at 1 m.

    How strong sound from elsewhere is, no law says; its presence is the probability that it is heard.
    """
    return wall_level_db(torch.ones_like(length))


def new_path(
    name: str, length: Tensor, level_db: Tensor, presence: float | Tensor = 1.0, bearing: float | Tensor = 0.0
) -> Path:
    """Return a path of an ideal sonar: without spread, lag or cycle slips."""
    zero = number(0.0)
    slips = number([0.0]), number([1.0])
    return Path(name, length, torch.atleast_2d(level_db), number(presence), zero, zero, *slips, number(bearing))


def direct_path(conditions: Conditions) -> Path:
    """Return the direct path: level of a flat wall, at the bearing of the reflector."""
    distance = conditions.distance
    return new_path("direct", distance, wall_level_db(distance), bearing=conditions.angle)
