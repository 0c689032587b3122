"""What pings hear that is not of themselves: the pings before them, other sonars, and whatever moves about."""

from __future__ import annotations

import numpy as np

from acquisition.bench.acoustics.air import Floats
from acquisition.bench.acoustics.arrivals import BOUNCE, LEAK, OTHER, Arrivals, Complexes, Integers
from acquisition.bench.acoustics.interference import Mover, Neighbour, Reverberation
from acquisition.bench.acoustics.receiver import Pulses
from acquisition.bench.acoustics.room import arrivals
from acquisition.bench.acoustics.scene import loudness
from acquisition.bench.acoustics.transducer import LENGTH, PERIOD, REFERENCE_C, pulse_phases
from acquisition.bench.reception import Hearing
from acquisition.bench.unit import DEG

LONG_S = 0.15  # after which a neighbour's burst has died away


def others(batch: Hearing, rng: np.random.Generator) -> list[Pulses]:
    """Return everything that the pings of a batch hear besides themselves; row is the ping in the batch."""
    found = [*_ghosts(batch), *(_moving(batch, thing) for thing in batch.setup.movers)]
    for other in batch.setup.neighbours:
        found += _neighbour(batch, other)
    if batch.setup.reverberation is not None:
        found.append(_reverberating(batch, batch.setup.reverberation, rng))
    return [part for part in found if len(part.row)]


def _ghosts(batch: Hearing) -> list[Pulses]:
    """Return what is left of the pings before, of what those faced."""
    row, sooner, lag = _before(batch)
    if not len(row):
        return []
    takes, source = np.unique(batch.all.visits.take[sooner], return_inverse=True)
    scene = batch.scene_of(takes)
    way = _heard_by_others(arrivals(scene))
    pair, index = _pairs(source, way.row, len(takes))
    pulses = batch.pulses_of(way, scene.air)
    return [_kept(batch, row[pair], pulses.delay[index] - lag[pair], pulses.weight[index])]


def _before(batch: Hearing) -> tuple[Integers, Integers, Floats]:
    """Return which pings of a batch still hear which pings before them, and how many seconds lie between."""
    later, sooner, lag = batch.all.echo
    place = np.full(len(batch.all.ping), -1)
    place[batch.rows] = np.arange(len(batch.rows))
    mine = np.flatnonzero(place[later] >= 0)
    return place[later[mine]], sooner[mine], lag[mine]


def _reverberating(batch: Hearing, of: Reverberation, rng: np.random.Generator) -> Pulses:
    """Return the mixed sound of these pings and of those before, a pulse of chance a period."""
    since = np.arange(batch.samples, dtype=np.float64) * PERIOD
    power = np.repeat(of.power(since)[None], len(batch.rows), axis=0)
    row, _, lag = _before(batch)
    np.add.at(power, row, of.power(since + lag[:, None]))
    white = rng.standard_normal((*power.shape, 2)).view(np.complex128)[..., 0] / np.sqrt(2.0)
    ringing = np.sqrt((np.abs(pulse_phases(batch.unit, REFERENCE_C)[0]) ** 2).sum())
    weight = loudness(batch.unit, batch.setup.supply) * np.sqrt(power) / ringing * white
    rows, at = np.nonzero(power)
    return Pulses(rows, since[at], weight[rows, at])


def _moving(batch: Hearing, thing: Mover) -> Pulses:
    """Return the echo of a person or a thing from where it is at each ping."""
    points = thing.places(batch.time)
    away = np.maximum(np.linalg.norm(points, axis=-1), 0.05)
    level = np.sqrt(thing.radius / (thing.radius + away)) / (2.0 * away) * batch.scene.beam(points, batch.take) ** 2
    pulses = batch.pulses_of(Arrivals.of(batch.take, OTHER, away, level), batch.scene.air)
    return _kept(batch, np.flatnonzero(level != 0.0), pulses.delay, pulses.weight)


def _neighbour(batch: Hearing, other: Neighbour) -> list[Pulses]:
    """Return another sonar's sound, straight and by way of everything that returns this one's."""
    row, offset = other.firings(batch.time, LONG_S, batch.setup.listening)
    scene, take = batch.scene, batch.take[row]
    beam = scene.towards(np.full(len(scene), np.cos(other.bearing_deg * DEG)))[take]
    path = np.full(len(row), 0.5 * other.path_m)
    level = loudness(batch.unit, batch.setup.supply) * 10.0 ** (other.strength_db / 20.0) * beam / other.path_m
    weight = (scene.air.loss(take, path) * level).astype(np.complex128)
    found = [_kept(batch, row, scene.air.delay(take, path) + offset, weight)]
    if other.beside_m is not None:
        way = _heard_by_others(batch.way)
        aside = Arrivals(way.row, way.group, np.hypot(way.length, 0.5 * other.beside_m), way.amplitude)
        pulses = batch.pulses_of(aside, scene.air)
        pair, index = _pairs(take, aside.row, len(scene))
        found.append(_kept(batch, row[pair], pulses.delay[index] + offset[pair], pulses.weight[index]))
    return found


def _heard_by_others(way: Arrivals) -> Arrivals:
    return way[(way.group != LEAK) & (way.group != BOUNCE)]


def _kept(batch: Hearing, row: Integers, delay: Floats, weight: Complexes) -> Pulses:
    """Return those pulses that fall into the waveform, be it with their end."""
    keep = (delay > -LENGTH) & (delay < batch.samples * PERIOD)
    return Pulses(row[keep], delay[keep], weight[keep])


def _pairs(source: Integers, row: Integers, count: int) -> tuple[Integers, Integers]:
    """Return each source with every way of the scene that it names: numbers of sources and of ways.

    Args:
        source: scene of each, (p,).
        row: scene of each way, (k,), any order.
        count: of the scenes.
    """
    order = np.argsort(row, kind="stable")
    each = np.bincount(row, minlength=count)
    first = np.cumsum(each) - each
    number = each[source]
    pair = np.repeat(np.arange(len(source)), number)
    within = np.arange(len(pair)) - np.repeat(np.cumsum(number) - number, number)
    return pair, order[first[source][pair] + within]
