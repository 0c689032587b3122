"""Family "bursts": readings a few milliseconds apart, each of which depends on the last.

In most bursts the next ping is fired a fixed wait after the echo, as a loop without a pause does it. The echo of the
previous ping by a path of half length F then arrives at F - x[k] - w, with w = c wait / 2: for the second bounce at a
target at D, F = 2 D, and x[k+1] = 2 D - x[k] - w. In the others pings are fired every 60 ms, and F - c interval / 2
does not depend on the reading.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from training.diagnosis.generators.beam import SCALE_CAUSES, SPEED, SPEED_C, changed, speed_ratio
from training.diagnosis.generators.world import (
    LINK_CAUSES,
    Cause,
    Family,
    Planted,
    Register,
    Rng,
    Surveys,
    World,
    scattered,
)

WAITS_S = (0.002, 0.005, 0.01)  # after an echo
INTERVAL_S = 0.06  # of bursts with a fixed interval
PAUSE_S = 0.5  # between bursts, longer than between any pings of one
NEAREST_M = 0.03
LISTEN_M = 5.0  # way in which a ping without echo is given up


@dataclass(frozen=True)
class BurstSonar:
    """A sonar that is fired fast in front of a wall.

    Attributes:
        wait_s: from an echo to the next ping, s; 0 for a fixed interval.
        presence: probability that the previous ping's late echo is strong enough.
        far_m: half the path of that echo, m; 0 for the second bounce, at twice the distance of the wall.
        settle_m: excess of the first reading of a burst, m, which halves with each ping.
        noise_m, noise_per_metre: standard deviation of a range, m, and its growth.
        missed: probability of no echo.
        alarms_per_m, placement_m, scale, offset_m, temperature_c: see `beam.BeamSonar`.
    """

    wait_s: float
    presence: float
    far_m: float
    settle_m: float
    noise_m: float
    noise_per_metre: float
    missed: float
    placement_m: float
    alarms_per_m: float = 0.0
    scale: float = 1.0
    offset_m: float = 0.0
    temperature_c: float = SPEED_C

    def read(self, ping: Ping, rng: Rng) -> tuple[Ping, Floats]:
        """Return the pings, with their times, and readings, m, 0 for no echo. All bursts have the same length."""
        length = len(ping) // int((np.diff(ping.time, prepend=-np.inf) > PAUSE_S).sum())
        wall = scattered(ping, self.placement_m, rng).reshape(-1, length)
        time = ping.time.reshape(-1, length).copy()
        range_m = np.empty_like(wall)
        for k in range(length):
            late = self._late_echo(wall[:, k], time[:, k] - time[:, k - 1], rng) if k else np.inf
            range_m[:, k] = np.minimum(self._first(wall[:, k], k, rng), late)
            if self.wait_s and k + 1 < length:
                spent = 2.0 * np.minimum(range_m[:, k], LISTEN_M) / SPEED + self.wait_s
                time[:, k + 1] = time[:, k] + spent
        value = self.scale * (range_m.ravel() * float(speed_ratio(self.temperature_c)) + self.offset_m)
        logged = Ping.of(ping.distance, ping.angle, ping.incidence, ping.reflectance, time.ravel(), ping.run)
        return logged, np.where(range_m.ravel() < LISTEN_M, np.maximum(value, 1e-3), 0.0)

    def _first(self, wall: Floats, place: int, rng: Rng) -> Floats:
        """Return the ping's own first arrival, m; infinity for none."""
        noise = (self.noise_m + self.noise_per_metre * wall) * rng.standard_normal(len(wall))
        own = wall + self.settle_m * 0.5**place + noise
        own = np.where(rng.random(len(wall)) < self.missed, np.inf, own)
        return np.minimum(own, rng.exponential(1.0 / max(self.alarms_per_m, 1e-9), len(wall)))

    def _late_echo(self, wall: Floats, since_s: Floats, rng: Rng) -> Floats:
        """Return the arrival of the previous ping's echo by the longer path, m; infinity for none."""
        path = self.far_m or 2.0 * wall
        arrival = path - 0.5 * SPEED * since_s + self.noise_m * rng.standard_normal(len(wall))
        return np.where((arrival > NEAREST_M) & (rng.random(len(wall)) < self.presence), arrival, np.inf)


def draw_world(rng: Rng) -> World:
    """Return a random sonar; in two of five, both the simulation and the recording hear the previous ping."""
    wait = float(rng.choice([*WAITS_S, 0.0]))
    sonar = BurstSonar(
        wait_s=wait,
        presence=float(rng.uniform(0.1, 0.9)) if rng.random() < 0.4 else 0.0,
        far_m=_far(wait, rng),
        settle_m=float(rng.choice([0.0, rng.uniform(0.0, 0.02)])),
        noise_m=float(rng.uniform(0.0005, 0.004)),
        noise_per_metre=float(rng.uniform(0.0, 0.002)),
        missed=float(rng.uniform(0.0, 0.03)),
        placement_m=float(rng.uniform(0.0, 0.003)),
        temperature_c=float(rng.uniform(17.0, 27.0)),
    )
    return World(sonar, Register.draw(rng))


def _far(wait_s: float, rng: Rng) -> float:
    """Return half the path of the late echo, m: of a far wall, or 0 for the second bounce."""
    if not wait_s:
        return float(0.5 * SPEED * INTERVAL_S + rng.uniform(0.4, 1.5))
    return 0.0 if rng.random() < 0.6 else float(rng.uniform(3.0, 5.0))


def draw_surveys(rng: Rng, pings: int, fixed: Mapping[str, Any]) -> Surveys:
    """Return surveys of some distances with several bursts at each."""
    length, positions = int(rng.integers(5, 21)), int(rng.integers(6, 17))
    bursts = max(1, round(pings / (length * positions)))
    nearest = float(rng.uniform(0.2, 0.8))
    marks = np.round(rng.uniform(nearest, nearest + 2.5, positions), 3)
    other = marks if rng.random() < 0.5 else np.round(rng.uniform(nearest, nearest + 2.5, positions), 3)
    between = np.round(rng.uniform(nearest, nearest + 2.5, max(3, positions // 3)), 3)
    missing = ("reflectance", "incidence_deg") if rng.random() < 0.5 else ()
    simulated, recorded, fresh = (_survey(m, bursts, length, rng) for m in (marks, other, between))
    return Surveys(simulated, recorded, fresh, missing)


def _survey(marks: Floats, bursts: int, length: int, rng: Rng) -> Ping:
    """Return bursts at distances in random order, with pings every 60 ms unless the sonar fires by itself."""
    start = np.repeat(10.0 * np.arange(len(marks)), bursts) * bursts + np.tile(3.0 * np.arange(bursts), len(marks))
    time = (start[:, None] + INTERVAL_S * np.arange(length)).ravel()
    return Ping.of(np.repeat(rng.permutation(marks), bursts * length), time=time)


def _plant_previous(world: World, size: float, rng: Rng) -> Planted:
    presence = min(0.95, 0.3 * size)
    far = world.sonar.far_m or None
    return Planted(world.with_sonar(presence=0.0), world.with_sonar(presence=presence), far)


CAUSES = (
    Cause("previous_ping", _plant_previous, ("early", "memory", "bias"), parameter="far_m"),
    *SCALE_CAUSES,
    Cause("travel_time_jitter", changed(lambda s, k, r: {"noise_m": s.noise_m * (1.0 + k)}), ("spread",)),
    Cause(
        "false_alarm",
        changed(lambda s, k, r: {"alarms_per_m": 0.08 * k}, "alarms_per_m"),
        ("early", "skew"),
        parameter="per_metre",
    ),
    *LINK_CAUSES,
)
FAMILY = Family(draw_world, draw_surveys, CAUSES)
