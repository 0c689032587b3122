"""What to measure next, in plain English: one measurement for all surviving explanations, or one for each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from noise.discrepancy.judge.proposal import DEG, Proposal, propose
from noise.effects.medium import ASSUMED_TEMPERATURE_C
from noise.fitting.stack import Stack

HOPELESS = 0.02  # nats per ping: more than 500 pings, whose errors under any law weigh more than what they tell; ours


@dataclass(frozen=True)
class Measurement:
    """A measurement worth making.

    Attributes:
        do: in plain English.
        separates: the effects that it tells apart.
        pings: to 10.8 nats (99 %).
        proposal: where to measure and what to set; None where another instrument tells.
        warmer_k: by how much warmer than the simulation's air a thermometer shows it, if the temperature is the cause.
    """

    do: str
    separates: tuple[str, ...]
    pings: int
    proposal: Proposal | None = field(default=None, compare=False)
    warmer_k: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as the verdict file has it, in words."""
        return {"do": self.do, "separates": list(self.separates), "pings": self.pings}

    def settings(self) -> dict[str, Any]:
        """Return it as the verdict file has it for machines: conditions (mm, degrees), what else to set or expect."""
        out: dict[str, Any] = {"pings": self.pings, "conditions": [], "also": {}}
        if self.proposal is not None:
            ping = self.proposal.ping
            columns = {"distance_mm": 1000.0 * ping.distance, "angle_deg": ping.angle / DEG}
            columns["incidence_deg"] = ping.incidence / DEG
            rows = np.round(np.stack(list(columns.values()), axis=1), 3).tolist()
            out["conditions"] = [dict(zip(columns, row, strict=True)) for row in rows]
            out["also"] = dict(self.proposal.setting.also)
        return out if self.warmer_k is None else {**out, "expected": {"warmer_k": round(self.warmer_k, 2)}}


# what is no condition of a ping, another instrument tells for sure
READ = "read a thermometer beside the sensor (the readings say {temperature})"
LOG = "log a thermometer beside the sensor through the whole session"
LOG_TWICE = "log a thermometer, and start a second session with the sensor still warm"
NOTHING = "no distance, angle, gain or ping interval tells these apart: inspect the sensor and its link instead"
Rivals = Sequence[tuple[str, str, Stack]]


def next_measurement(
    own: Stack, rivals: Rivals, seed: int, simulation: Stack | None = None, seen: Ping | None = None
) -> list[Measurement]:
    """Return the measurements that tell surviving rivals apart, each once.

    Args:
        own: the explanation.
        rivals: (chosen effect, rival effect, rival explanation) of each that survives.
        seed: of the draws.
        simulation: the law that stands for a simulation whose own temperature nobody stated; None where 22.8 degC is
            what the sensor assumes.
        seen: conditions that were recorded; nothing far from them is proposed.
    """
    told = [(rival, _thermometer(*rival[:2])) for rival in rivals]
    read = [_read_off(text, own, *rival, simulation) for rival, text in told if text]
    others = [rival for rival, text in told if not text]
    return merged([*read, *_measured(own, others, seed, seen)])


def merged(measurements: Sequence[Measurement]) -> list[Measurement]:
    """Return measurements with those that ask for the same thing made one."""
    out: dict[str, Measurement] = {}
    for m in measurements:
        same = out.get(m.do, m)
        separates = tuple(dict.fromkeys((*same.separates, *m.separates)))
        out[m.do] = replace(same, separates=separates, pings=max(same.pings, m.pings))
    return list(out.values())


def _measured(own: Stack, rivals: Rivals, seed: int, seen: Ping | None) -> list[Measurement]:
    """Return one measurement for all rivals where that takes no more pings than one for each."""
    each = [(rival, propose(own, [rival[2]], seed, seen)) for rival in rivals]
    alone = [_told(found, rival[:2]) for rival, found in each]
    within_reach = [(rival, found) for rival, found in each if found.nats >= HOPELESS]
    if len(within_reach) < 2:
        return alone
    together = propose(own, [rival[2] for rival, _ in within_reach], seed, seen)
    if together.pings > sum(found.pings for _, found in within_reach):
        return alone
    names = tuple(dict.fromkeys(name for rival, _ in within_reach for name in rival[:2]))
    return [_told(together, names), *(m for m in alone if m.do == NOTHING)]


def _told(found: Proposal, separates: tuple[str, ...]) -> Measurement:
    if found.nats < HOPELESS:
        return Measurement(NOTHING, separates, 0)
    return Measurement(_tell(found.ping) + found.setting.words, separates, found.pings, found)


def _thermometer(one: str, other: str) -> str:
    """Return what to do with a thermometer where it tells two effects apart, nothing where it does not."""
    if "thermal_drift" in (one, other):
        return LOG_TWICE if "warm_up" in (one, other) else LOG
    return READ if "sound_speed" in (one, other) else ""


def _read_off(text: str, own: Stack, chosen: str, rival: str, other: Stack, simulation: Stack | None) -> Measurement:
    warm = (own if chosen == "sound_speed" else other).get(("sound_speed", "temperature_c"))
    usual = ASSUMED_TEMPERATURE_C if simulation is None else simulation.get(("sound_speed", "temperature_c"))
    shown = warm - usual if "{temperature}" in text else None
    return Measurement(text.format(temperature=_warmth(warm, simulation)), (chosen, rival), 1, warmer_k=shown)


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
