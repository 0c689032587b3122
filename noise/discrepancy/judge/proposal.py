"""Where explanations differ most: the conditions under which the nearest of several rivals is told from the chosen one.

Conditions are those a user can set: distance, what is turned and how far, the receiver's gain, the time between pings,
how long is listened, how long the sensor has been on. Everything that a setting does to the physics it does under every
explanation; what counts is the expected log likelihood ratio per ping (half of Jeffreys' divergence), each ping at a
newly placed target.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition import Ping, Reading
from noise.discrepancy.name.rivals import SETTLED
from noise.effects.medium import AIR_SCALE_SD
from noise.fitting.stack import Stack
from noise.fitting.visit_effects import FLOOR, single_ping_law
from noise.law import EchoLaw, Floats

DISTANCES = np.array([0.15, 0.25, 0.4, 0.6, 0.9, 1.3, 1.8, 2.5, 3.5, 4.5, 6.0])
ANGLES_DEG = np.array([-20.0, 0.0, 5.0, 10.0, 20.0, 30.0])
SPEED_HALF = 172.0  # m/s; range per second of delay
FARTHEST = 11.008  # m; SRF08 with range register 255
DRAWS, CLOSER = 60, 2000  # readings a condition: to look everywhere; to choose among the best, where chance would win
SHORTLIST = 12  # conditions that are looked at closer
SURE_Z = 2.3263  # 99 % of a normal; its square is half of what settles: a normal ratio varies by twice its mean
# beyond what was recorded a law is a guess: only where little was varied, by so many times and so much more; ours
VARIED, FARTHER = 2.0, 2.0
VARIED_DEG, MORE_DEG = 20.0, 10.0
START_S = "start_s"  # how long the sensor has been on
LATER_S = 7200.0  # by then every sensor is warm
UNTRIED = 1.0 / 3.0  # of what a setting seems to tell that was the same in all of the recording; ours
TOGETHER = 5  # conditions proposed at once, so that no single misplaced target decides
DEG = np.pi / 180.0
SLIGHTLY = 1e-6  # rad


def _as_is(stack: Stack) -> Stack:
    return stack


def _more_gain(stack: Stack) -> Stack:
    loss = stack.get(("sensitivity", "loss_db"))
    return stack.put([("sensitivity", "loss_db")], [max(loss - 6.0, 0.0)])


def _less_gain(stack: Stack) -> Stack:
    return stack.put([("sensitivity", "loss_db")], [min(stack.get(("sensitivity", "loss_db")) + 6.0, 80.0)])


def _later_ping(stack: Stack) -> Stack:
    if "previous_ping" not in stack.values:
        return stack
    key = ("previous_ping", "far_m")
    return stack.put([key], [stack.get(key) - 0.005 * SPEED_HALF])


def _longest_range(stack: Stack) -> Stack:
    key = ("range_gate", "listen_m")
    return stack.put([key], [FARTHEST]) if "range_gate" in stack.values else stack


@dataclass(frozen=True)
class Setting:
    """What can be set besides where the target stands.

    Attributes:
        words: in plain English, to follow "place the target at ...".
        change: what it does under every explanation.
        bearing, incidence: share of the angle by which the sensor, and the target's face, is turned away.
        also: the same for machines: by how much a quantity is to change, or `range_m` and `start_s` to be.
    """

    words: str
    change: Callable[[Stack], Stack] = _as_is
    bearing: float = 1.0
    incidence: float = 1.0
    also: tuple[tuple[str, float], ...] = ()

    @property
    def trust(self) -> float:
        """Share of what it seems to tell that counts: what was never set otherwise is known from data sheets alone."""
        return UNTRIED if self.also else 1.0

    def pings(self, seen: Ping | None = None) -> Ping:
        """Return the conditions that are considered: not far from what was recorded, where that is given."""
        distance, angle = np.meshgrid(DISTANCES, ANGLES_DEG * DEG, indexing="ij")
        turned = angle.ravel()
        time = np.full(len(turned), dict(self.also).get(START_S, 0.0))
        ping = Ping.of(distance.ravel(), self.bearing * turned, incidence=self.incidence * turned, time=time)
        return ping if seen is None else ping[_not_far(ping, seen)]


def _not_far(ping: Ping, seen: Ping) -> NDArray[np.bool_]:
    """Tell which pings lie where the laws hardly extrapolate; all, where none does."""
    least, most = seen.distance.min(), seen.distance.max()
    farther = FARTHER if most < VARIED * least else 1.0
    near = (ping.distance <= farther * most) & (ping.distance >= least / farther)
    # a face that was never turned says nothing of what is heard of it askew
    for turned, so_far in ((ping.angle, seen.angle), (ping.incidence, seen.incidence)):
        most = np.abs(so_far).max()
        near &= np.abs(turned) <= most + (MORE_DEG * DEG if most < VARIED_DEG * DEG else SLIGHTLY)
    return near if near.any() else np.ones(len(ping), dtype=bool)


USUAL = Setting("")
SETTINGS = (
    USUAL,
    Setting(", turning the sensor alone", incidence=0.0),
    Setting(", turning the target alone", bearing=0.0),
    Setting(", with 6 dB more receiver gain", _more_gain, also=(("gain_db", 6.0),)),
    Setting(", with 6 dB less receiver gain", _less_gain, also=(("gain_db", -6.0),)),
    Setting(", with 5 ms more between pings", _later_ping, also=(("interval_s", 0.005),)),
    Setting(", listening as long as the sensor can", _longest_range, also=(("range_m", FARTHEST),)),
)
LATER = Setting(", after the sensor has been on for two hours", also=((START_S, LATER_S),))


@dataclass(frozen=True, eq=False)
class Proposal:
    """Conditions to measure under.

    Attributes:
        ping: the conditions, (`TOGETHER`,).
        setting: what else to set.
        nats: least expected log likelihood ratio per ping against any rival.
        pings: number until the nearest rival is settled: 10.8 nats, and the right one preferred with 99 % even where
            few pings tell nearly everything; at least one for each condition.
    """

    ping: Ping
    setting: Setting
    nats: float
    pings: int


def propose(own: Stack, others: Sequence[Stack], seed: int, seen: Ping | None = None) -> Proposal:
    """Return the conditions under which the nearest rival lies farthest from an explanation.

    Args:
        own: the explanation.
        others: its rivals.
        seed: of the draws.
        seen: conditions that were recorded; the laws are trusted little beyond them.
    """
    # how air drifts two hours on is anybody's guess
    drifts = any("thermal_drift" in stack.values for stack in (own, *others))
    settings = SETTINGS if drifts else (*SETTINGS, LATER)
    looked = [_shortlist(own, others, setting, seed, seen) for setting in settings]
    worth = [setting.trust * nats for setting, (nats, _) in zip(settings, looked, strict=True)]
    order = np.argsort(-np.array(worth), kind="stable")[:2]
    closer = [_closer(own, others, settings[k], looked[k][1], seed) for k in order]
    return max(closer, key=lambda found: found.setting.trust * found.nats)


def _shortlist(
    own: Stack, others: Sequence[Stack], setting: Setting, seed: int, seen: Ping | None
) -> tuple[float, Ping]:
    """Return about how far the best conditions of a setting tell, and the conditions worth a closer look."""
    ping = setting.pings(seen)
    least = np.min(
        [ratios(own, other, ping, setting.change, seed, DRAWS).mean(axis=(0, 2)) for other in others], axis=0
    )
    order = np.argsort(-least, kind="stable")
    return float(least[order[:TOGETHER]].mean()), ping[order[:SHORTLIST]]


def _closer(own: Stack, others: Sequence[Stack], setting: Setting, ping: Ping, seed: int) -> Proposal:
    """Return the best of a shortlist, by readings of their own."""
    ratio = np.stack([ratios(own, other, ping, setting.change, seed + 1, CLOSER) for other in others])
    rows = np.argsort(-ratio.mean(axis=(1, 3)).min(axis=0), kind="stable")[:TOGETHER]
    best = ratio[:, :, rows]
    nats = best.mean(axis=(1, 2, 3))
    one_way, varies = best.mean(axis=(2, 3)), best.var(axis=(2, 3))
    chance = SURE_Z**2 * varies / np.maximum(one_way, 1e-6) ** 2
    pings = max(TOGETHER, SETTLED / max(float(nats.min()), 1e-6), float(chance.max()))
    return Proposal(ping[rows], setting, float(nats.min()), int(np.ceil(min(pings, 1e9))))


def ratios(own: Stack, other: Stack, ping: Ping, change: Callable[[Stack], Stack], seed: int, draws: int) -> Floats:
    """Return log likelihood ratios, nats, of what either of two explanations draws, for it, (2, n, draws)."""
    repeated = ping[np.repeat(np.arange(len(ping)), draws)]
    laws = [law(change(stack), repeated) for stack in (own, other)]
    out = []
    for k, drawn in enumerate(laws):
        reading = drawn.sample(np.random.default_rng([seed, k]))
        out.append((floored(drawn, reading) - floored(laws[1 - k], reading)).reshape(len(ping), draws))
    return np.stack(out)


def law(stack: Stack, ping: Ping) -> EchoLaw:
    """Return the law of pings that each face a newly placed target, in the air of another day."""
    model, cells = stack.build()
    return single_ping_law(model.law(ping), cells, AIR_SCALE_SD)


def floored(predicted: EchoLaw, reading: Reading) -> Floats:
    """Return log probabilities with the floor of arbitrary readings and silences in them, nats, (n,)."""
    arbitrary = FLOOR * np.where(reading.echo, 1e-4, 1.0)
    return np.log((1.0 - 2.0 * FLOOR) * np.exp(predicted.log_prob(reading)) + arbitrary)
