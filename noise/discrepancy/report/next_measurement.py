"""The next measurement: what to do so that explanations that the data do not separate are told apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Bits, Floats
from noise.discrepancy.name.alternatives import Place
from noise.discrepancy.name.candidates import keys_of
from noise.discrepancy.report.design import (
    HAND,
    ROUNDS,
    Candidates,
    Design,
    Rival,
    Setting,
    best_design,
    candidates_of,
    checked,
    evaluated,
    settings_of,
    weigh,
)
from noise.discrepancy.result import Measurement
from noise.effects.medium import TEMPERATURE
from noise.fitting.batch import Batch
from noise.fitting.threads import one_thread

DECIDED = 10.8  # nats; a normal log-likelihood ratio of this mean has the right sign with 99 %
HOPELESS = 0.02  # nats per visit: more than 500 visits, whose errors under any law outweigh what they tell
# share of its nats that counts for a setting that the recording never had: its effect is known from data sheets only
UNTRIED = 1.0 / 3.0
TURNED = 0.8  # the same for turned sensors and targets, whose angles have to be set too
THERMOMETER = "read a thermometer beside the sensor"
LOG = "log a thermometer beside the sensor through the whole recording"
NOTHING = "no distance, angle, gain or ping interval separates these: inspect the sensor and its cable"


@dataclass(frozen=True, eq=False)
class _Proposal:
    """A design for pairs of effects, under the usual setting and, where given, under another one too."""

    separates: tuple[str, ...]
    tables: tuple[Candidates, ...]
    design: Design

    @property
    def pings(self) -> int:
        k = len(self.design.rows)
        return k * math.ceil(DECIDED / (self.design.nats * k))


def next_measurements(places: Sequence[Place], batch: Batch, rng: np.random.Generator) -> tuple[Measurement, ...]:
    """Return the measurements that separate the alternatives of every place, fewest pings first.

    Args:
        places: selected effects with their alternatives.
        batch: recorded pings; conditions far from theirs are not proposed.
        rng: draws readings of the laws that are compared.
    """
    instruments: list[Measurement] = []
    proposals: list[_Proposal] = []
    with one_thread():
        for place in places:
            for other in list(place.listed)[1:]:
                pair = (place.effect, other)
                if set(pair) & {"sound_speed", "thermal_drift"} and TEMPERATURE not in batch.ping.covariates:
                    instruments.append(_thermometer(pair))
                else:
                    proposals.append(_proposed(place, other, batch, rng))
        measured = [_measurement(each) for each in _joined(proposals, rng)]
    return tuple(sorted(merged([*instruments, *measured]), key=lambda each: (each.pings == 0, each.pings)))


def merged(measurements: Sequence[Measurement]) -> tuple[Measurement, ...]:
    """Return measurements with those that ask for the same made one, which separates the effects of all."""
    out: dict[str, Measurement] = {}
    for each in measurements:
        same = out.get(each.do, each)
        separates = tuple(dict.fromkeys((*same.separates, *each.separates)))
        out[each.do] = Measurement(each.do, separates, max(same.pings, each.pings), same.conditions, same.also)
    return tuple(out.values())


def _thermometer(pair: tuple[str, str]) -> Measurement:
    do, every = (LOG, "every ping") if "thermal_drift" in pair else (THERMOMETER, "once")
    return Measurement(do, pair, 1, also={"thermometer": every})


def _proposed(place: Place, other: str, batch: Batch, rng: np.random.Generator) -> _Proposal:
    """Return the best design with the usual setting or with one other setting."""
    own, rival = (place.fits[name].stacks[0] for name in (place.effect, other))
    rivals = (
        Rival(own, rival, keys_of(rival, other, batch)),
        Rival(rival, own, keys_of(own, place.effect, batch)),
    )
    facing = candidates_of(batch, facing=True)
    options = [(Candidates(facing), Candidates(facing, s)) for s in settings_of((own, rival), batch)]
    rough = [best_design(rivals, tables, rng, rounds=0).nats for tables in options]
    tried = {
        (Candidates(facing),): 1.0,
        (Candidates(candidates_of(batch)),): TURNED,
        options[int(np.argmax(rough))]: UNTRIED,
    }
    designs = {tables: checked(tables, best_design(rivals, tables, rng, ROUNDS), rng) for tables in tried}
    tables = max(tried, key=lambda each: tried[each] * designs[each].nats)
    return _Proposal((place.effect, other), tables, designs[tables])


def _joined(proposals: Sequence[_Proposal], rng: np.random.Generator) -> list[_Proposal]:
    """Return proposals with those of one setting made one design where that takes fewer pings in total."""
    out = [each for each in proposals if each.design.nats < HOPELESS]
    groups: dict[str, list[_Proposal]] = {}
    for each in proposals:
        if each.design.nats >= HOPELESS:
            tables = each.tables
            groups.setdefault(f"{[len(t.ping) for t in tables]} {tables[-1].setting.words}", []).append(each)
    for group in groups.values():
        if len(group) == 1:
            out += group
            continue
        ratios = np.concatenate([each.design.ratios for each in group])
        names = tuple(dict.fromkeys(name for each in group for name in each.separates))
        rivals, tables = [rival for each in group for rival in each.design.rivals], group[0].tables
        together = _Proposal(names, tables, checked(tables, evaluated(weigh(ratios), rivals, ratios), rng))
        alone = sum(each.pings for each in group)
        out += [together] if together.design.nats >= HOPELESS and together.pings <= alone else group
    return out


def _measurement(found: _Proposal) -> Measurement:
    if found.design.nats < HOPELESS:
        return Measurement(NOTHING, found.separates, 0)
    setting, rows = found.tables[-1].setting, found.design.rows
    n = len(found.tables[0].ping)
    changed = rows >= n if len(found.tables) > 1 else np.zeros(len(rows), dtype=bool)
    ping = found.tables[0].ping[rows % n]
    columns = {name: getattr(ping, name) for name in ("distance", "angle", "incidence", "reflectance")}
    if setting.column == HAND:
        columns["distance"] = np.where(changed, setting.value, columns["distance"])
    count = found.pings // len(rows)
    visits = f"{count} visit{'' if count == 1 else 's'}{' each' if len(rows) > 1 else ''}"
    do = f"{_places(columns, changed, setting)}; {visits}, placing the target anew for every visit"
    listed = {name: tuple(float(x) for x in value) for name, value in columns.items()}
    if not changed.any():
        return Measurement(do, found.separates, found.pings, listed)
    states = {"change": setting.value, "in_condition": [int(k) for k in np.flatnonzero(changed)]}
    return Measurement(do, found.separates, found.pings, listed, {setting.column: states})


def _places(columns: dict[str, Floats], changed: Bits, setting: Setting) -> str:
    """Return conditions in words, those under another setting last."""
    parts = []
    for rows, words in ((~changed, ""), (changed, f" with {setting.words}")):
        if rows.any():
            distance, angle, incidence, shade = (value[rows] for value in columns.values())
            text = f"{_values(distance, 'm')}{_turns(angle, incidence)}"
            text += f", with reflectances of {_values(shade, '')}" if np.ptp(shade) > 0 else ""
            parts.append(text + words)
    return f"place the target at {', then at '.join(parts)}"


def _turns(angle: Floats, incidence: Floats) -> str:
    """Return in words what is turned, and by how much."""
    kinds = {
        "the sensor and the target": (angle, (angle != 0) & (incidence != 0)),
        "the sensor alone": (angle, (angle != 0) & (incidence == 0)),
        "the target alone": (incidence, (angle == 0) & (incidence != 0)),
    }
    parts = [
        f"{what} turned by {_values(np.rad2deg(by[rows]), '°')}" for what, (by, rows) in kinds.items() if rows.any()
    ]
    if parts and ((angle == 0) & (incidence == 0)).any():
        parts.insert(0, "straight ahead")
    return f", {' and '.join(parts)}" if parts else ""


def _values(value: Floats, unit: str) -> str:
    """Return the different values in words: all of two, the range of more.

    >>> _values(np.array([2.5, 0.4, 0.4]), "m"), _values(np.array([10.0]), "°")
    ('0.4 m and 2.5 m', '10°')
    """
    each = [f"{x:g} {unit}".strip().replace(" °", "°") for x in np.unique(np.round(value, 3))]
    if len(each) <= 2:
        return " and ".join(each)
    return f"{len(each)} values from {each[0]} to {each[-1]}"
