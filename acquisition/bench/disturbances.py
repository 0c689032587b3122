"""Sound in a ping that it did not cause: previous pings, other sonars, reverberation, moving objects."""

from __future__ import annotations

import numpy as np

from acquisition.arrays import Floats, Ints
from acquisition.bench.acoustics.arrivals import BOUNCE, LEAK, OTHER, Arrivals, Complexes
from acquisition.bench.acoustics.geometry import amplitude_scale
from acquisition.bench.acoustics.receiver import Pulses
from acquisition.bench.acoustics.room import arrivals
from acquisition.bench.acoustics.transducer import PERIOD, PULSE_LENGTH, REFERENCE_C, pulse_phases
from acquisition.bench.laboratory.interference import Mover, Neighbour, Reverberation
from acquisition.bench.laboratory.unit import DEG
from acquisition.bench.reception import Reception

BURST_LIFETIME_S = 0.15  # s, after which a neighbour's burst has decayed


def disturbances(batch: Reception, rng: np.random.Generator) -> list[Pulses]:
    """Return all sound in a batch that does not come from its own pings; `row` is the ping in the batch."""
    found = [*_previous_pings(batch), *(_mover_echo(batch, mover) for mover in batch.setup.movers)]
    for neighbour in batch.setup.neighbours:
        found += _neighbour(batch, neighbour)
    if batch.setup.reverberation is not None:
        found.append(_reverberation(batch, batch.setup.reverberation, rng))
    return [part for part in found if len(part.row)]


def _previous_pings(batch: Reception) -> list[Pulses]:
    """Return the late echoes of previous pings, in the scenes of those."""
    row, previous, lag = _overlaps(batch)
    if not len(row):
        return []
    segments, source = np.unique(batch.drawn.visits.segment[previous], return_inverse=True)
    geometry = batch.geometry_of(segments)
    paths = _external_paths(arrivals(geometry))
    pair, index = _source_path_pairs(source, paths.row, len(segments))
    pulses = batch.pulses_of(paths, geometry.air)
    return [_within_waveform(batch, row[pair], pulses.delay[index] - lag[pair], pulses.weight[index])]


def _overlaps(batch: Reception) -> tuple[Ints, Ints, Floats]:
    """Return overlapping pairs whose later ping is in the batch: its row, the previous ping, and the lag, s."""
    later, previous, lag = batch.drawn.overlaps
    place = np.full(len(batch.drawn.ping), -1)
    place[batch.rows] = np.arange(len(batch.rows))
    mine = np.flatnonzero(place[later] >= 0)
    return place[later[mine]], previous[mine], lag[mine]


def _reverberation(batch: Reception, of: Reverberation, rng: np.random.Generator) -> Pulses:
    """Return the diffuse reverberation of these pings and of previous ones, one random pulse per period."""
    since = np.arange(batch.samples, dtype=np.float64) * PERIOD
    power = np.repeat(of.power(since)[None], len(batch.rows), axis=0)
    row, _, lag = _overlaps(batch)
    np.add.at(power, row, of.power(since + lag[:, None]))
    white = rng.standard_normal((*power.shape, 2)).view(np.complex128)[..., 0] / np.sqrt(2.0)
    ringing = np.sqrt((np.abs(pulse_phases(batch.unit, REFERENCE_C)[0]) ** 2).sum())
    weight = amplitude_scale(batch.unit, batch.setup.supply) * np.sqrt(power) / ringing * white
    rows, at = np.nonzero(power)
    return Pulses(rows, since[at], weight[rows, at])


def _mover_echo(batch: Reception, mover: Mover) -> Pulses:
    """Return the echo of a moving object at its position at each ping."""
    points = mover.positions(batch.time)
    away = np.maximum(np.linalg.norm(points, axis=-1), 0.05)
    level = (
        np.sqrt(mover.radius / (mover.radius + away)) / (2.0 * away) * batch.geometry.beam(points, batch.segment) ** 2
    )
    pulses = batch.pulses_of(Arrivals.of(batch.segment, OTHER, away, level), batch.geometry.air)
    return _within_waveform(batch, np.flatnonzero(level != 0.0), pulses.delay, pulses.weight)


def _neighbour(batch: Reception, neighbour: Neighbour) -> list[Pulses]:
    """Return another sonar's sound, on the direct path and by way of the reflectors."""
    row, offset = neighbour.firings(batch.time, BURST_LIFETIME_S, batch.setup.listening)
    geometry, segment = batch.geometry, batch.segment[row]
    beam = geometry.beam_at_cosine(np.full(len(geometry), np.cos(neighbour.bearing_deg * DEG)))[segment]
    path = np.full(len(row), 0.5 * neighbour.path_m)
    level = (
        amplitude_scale(batch.unit, batch.setup.supply)
        * 10.0 ** (neighbour.strength_db / 20.0)
        * beam
        / neighbour.path_m
    )
    weight = (geometry.air.loss(segment, path) * level).astype(np.complex128)
    found = [_within_waveform(batch, row, geometry.air.delay(segment, path) + offset, weight)]
    if neighbour.beside_m is not None:
        paths = _external_paths(batch.paths)
        aside = Arrivals(paths.row, paths.group, np.hypot(paths.length, 0.5 * neighbour.beside_m), paths.amplitude)
        pulses = batch.pulses_of(aside, geometry.air)
        pair, index = _source_path_pairs(segment, aside.row, len(geometry))
        found.append(_within_waveform(batch, row[pair], pulses.delay[index] + offset[pair], pulses.weight[index]))
    return found


def _external_paths(paths: Arrivals) -> Arrivals:
    return paths[(paths.group != LEAK) & (paths.group != BOUNCE)]


def _within_waveform(batch: Reception, row: Ints, delay: Floats, weight: Complexes) -> Pulses:
    """Return the pulses that overlap the waveform."""
    keep = (delay > -PULSE_LENGTH) & (delay < batch.samples * PERIOD)
    return Pulses(row[keep], delay[keep], weight[keep])


def _source_path_pairs(source: Ints, row: Ints, count: int) -> tuple[Ints, Ints]:
    """Return all pairs of a source and a path in the source's scene, as indices of sources and of paths.

    Args:
        source: scene of each source, (p,).
        row: scene of each path, (k,), in any order.
        count: number of scenes.
    """
    order = np.argsort(row, kind="stable")
    each = np.bincount(row, minlength=count)
    first = np.cumsum(each) - each
    number = each[source]
    pair = np.repeat(np.arange(len(source)), number)
    within = np.arange(len(pair)) - np.repeat(np.cumsum(number) - number, number)
    return pair, order[first[source][pair] + within]
