"""What to measure next, in plain English: one measurement for all surviving explanations, or one for each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition import Ping
from noise.discrepancy.proposal import DEG, Proposal, propose
from noise.law import Floats
from noise.stack import Stack

HOPELESS = 0.004  # nats per ping: thousands of pings; not worth proposing


@dataclass(frozen=True)
class Measurement:
    """A measurement worth making.

    Attributes:
        do: in plain English.
        separates: the effects that it tells apart.
        pings: to 10.8 nats (99 %).
    """

    do: str
    separates: tuple[str, ...]
    pings: int


# what the laws cannot tell because it is no condition of a ping: read it off another instrument
OTHER_INSTRUMENT = {
    frozenset({"sound_speed", "clock_scale"}): "read a thermometer beside the sensor (the readings say {temperature})",
    frozenset({"thermal_drift", "sound_speed"}): "log a thermometer beside the sensor through the whole session",
    frozenset({"thermal_drift", "warm_up"}): "log a thermometer, and start a second session with the sensor still warm",
    frozenset({"thermal_drift", "clock_scale"}): "log a thermometer beside the sensor through the whole session",
}
NOTHING = "no distance, angle, gain or ping interval tells these apart: inspect the sensor and its link instead"
Rivals = Sequence[tuple[str, str, Stack]]


def next_measurement(own: Stack, rivals: Rivals, seed: int, simulation: Stack | None = None) -> list[Measurement]:
    """Return the measurements that tell surviving rivals apart, each once.

    Args:
        own: the explanation.
        rivals: (chosen effect, rival effect, rival explanation) of each that survives.
        seed: of the draws.
        simulation: the law that stands for a simulation whose own temperature nobody stated; None where 22.8 degC is
            what the sensor assumes.
    """
    read = [_read_off(own, *rival, simulation) for rival in rivals if frozenset(rival[:2]) in OTHER_INSTRUMENT]
    return merged([*read, *_measured(own, [r for r in rivals if frozenset(r[:2]) not in OTHER_INSTRUMENT], seed)])


def merged(measurements: Sequence[Measurement]) -> list[Measurement]:
    """Return measurements with those that ask for the same thing made one."""
    out: dict[str, Measurement] = {}
    for m in measurements:
        same = out.get(m.do, Measurement(m.do, (), 0))
        out[m.do] = Measurement(m.do, tuple(dict.fromkeys((*same.separates, *m.separates))), max(same.pings, m.pings))
    return list(out.values())


def _measured(own: Stack, rivals: Rivals, seed: int) -> list[Measurement]:
    """Return one measurement for all rivals where that takes no more pings than one for each."""
    each = [(rival, propose(own, [rival[2]], seed)) for rival in rivals]
    alone = [_told(found, rival[:2]) for rival, found in each]
    within_reach = [(rival, found) for rival, found in each if found.nats >= HOPELESS]
    if len(within_reach) < 2:
        return alone
    together = propose(own, [rival[2] for rival, _ in within_reach], seed)
    if together.pings > sum(found.pings for _, found in within_reach):
        return alone
    names = tuple(dict.fromkeys(name for rival, _ in within_reach for name in rival[:2]))
    return [_told(together, names), *(m for m in alone if m.do == NOTHING)]


def _told(found: Proposal, separates: tuple[str, ...]) -> Measurement:
    if found.nats < HOPELESS:
        return Measurement(NOTHING, separates, 0)
    return Measurement(_tell(found.ping) + found.setting.words, separates, found.pings)


def _read_off(own: Stack, chosen: str, rival: str, other: Stack, simulation: Stack | None) -> Measurement:
    warm = (own if chosen == "sound_speed" else other).get(("sound_speed", "temperature_c"))
    text = OTHER_INSTRUMENT[frozenset({chosen, rival})].format(temperature=_warmth(warm, simulation))
    return Measurement(text, (chosen, rival), 1)


def _warmth(celsius: float, simulation: Stack | None) -> str:
    if simulation is None:
        return f"{celsius:.1f} degC"
    more = celsius - simulation.get(("sound_speed", "temperature_c"))
    return f"{abs(more):.0f} K {'warmer' if more > 0 else 'colder'} than the simulation has it"


def _tell(ping: Ping) -> str:
    turned = np.where(ping.angle == 0.0, ping.incidence, ping.angle)
    metres = _span(np.unique(ping.distance), "m", "g")
    return f"place the target at {metres} and {_span(np.unique(np.rint(turned / DEG)), 'deg', '.0f')}"


def _span(value: Floats, unit: str, style: str) -> str:
    low, high = format(value.min(), style), format(value.max(), style)
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
