"""Directed test: the orthogonal test in the directions in which effects of the catalogue would change readings.

The score of a direction is the log-likelihood ratio of a reading, given those before it in its visit, between the law
with an effect at a typical size and the law itself. Its error under the law, which both files share, is a nuisance
g(x), as in `orthogonal_test`; one statistic for each direction, over all pings, is sensitive to what no interval of one
condition shows well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from acquisition import Reading, previous
from acquisition.arrays import Floats, Ints, Singles
from noise.discrepancy.locate.orthogonal import MIN_CLUSTERS, OVERLAP, Tested
from noise.discrepancy.moments.bootstrap import Greatest, p_of_greatest, studentised
from noise.discrepancy.moments.nuisance import CrossFit, basis_of, folds_of, units_of
from noise.discrepancy.moments.sample import DISTINCT, Sample, dependence
from noise.discrepancy.moments.scores import BIAS, level_of, ping_law
from noise.discrepancy.result import Aspect, Location, PValue
from noise.effects import CATALOGUE
from noise.effects.state import DETECTION_WIDTH_DB
from noise.fitting.batch import Batch
from noise.fitting.likelihood import Measure, at_each
from noise.fitting.stack import JITTER, Key, Stack
from noise.fitting.visit_effects import VisitEffects, in_visits, law_of, log_prob, single_ping_law, visit_errors
from noise.law import EchoLaw, GivenNumbers
from noise.physical import PhysicalLaw, PhysicalModel

MAX_PINGS = 6000  # of each file; more cost time, and the undirected test uses them all
MIN_VISITS = 30  # with fewer, the law follows the errors of placement in the simulation, which is then favoured
LIMIT_NATS = 4.0  # of a log-likelihood ratio: a single reading decides nothing
MAX_ROUNDS = 30  # of draws under a law that remembers; a chain of so many repeated readings is rare
LEAST_PROBABILITY = 1e-12  # of a reading, whose logarithm is finite
STEP_SHARE = 0.05  # of its bounds: change of a parameter that the law already has, and that has no typical size

OFFSET: Key = ("zero_offset", "offset_m")
LOST: Key = ("dropped_reading", "probability")

After = Callable[[Stack, Sequence[dict[Key, float]], Batch], Floats]  # of each change of a law and reading, nats


def directed_test(
    law: Stack,
    sample: Sample,
    signs: Singles,
    rng: np.random.Generator,
    tested: Tested | None = None,
    beside: Stack | None = None,
) -> Greatest:
    """Test whether the recording differs from the simulation in the direction of any effect.

    Both files are scored under one law, since the expected log-likelihood ratio depends on the law's own spread.

    Args:
        law: describes the simulation, with the wider scatter of placements of both files.
        sample: readings; where the law is known exactly, readings drawn from it are the simulation's.
        signs: of the sample's clusters in each draw of the bootstrap, (draws, clusters).
        rng: draws readings and folds.
        tested: test of regions of the same files, which tells whether errors of readings last longer than a cluster,
            and errors of range do, as where the pose of a robot drifts. What the first pings of a visit have shown is
            expected of the others, so that the ratios of single pings tell how long.
        beside: law of the recording, where it is known to differ; effects with other parameters are not tested.
    """
    recorded = law if beside is None else beside
    nothing = Greatest(PValue(1.0, len(signs), 0), np.empty(0))
    both, cluster = _thinned(law, sample, rng)
    if len(np.unique(cluster)) < MIN_VISITS:
        return nothing
    rows = zip((recorded, law), both.batches, both.left_out(law), strict=True)
    pairs = [(own.by_part(part), batch) for own, batch, part in rows]
    in_one_order = abs(both.follows_more) <= DISTINCT
    alike = [name for name in CATALOGUE if law.values.get(name) == recorded.values.get(name)]
    able = [name for name in alike if in_one_order or not CATALOGUE[name].remembers]
    names, ratios = directions(law, pairs, joint_log_prob_after, able)
    chains = sample.chains
    psi = _sums(law, both, cluster, ratios, chains.n, rng)
    valid = np.ones(ratios.shape, dtype=bool)
    drifts = tested is None or bool(tested.length[BIAS] > 1)
    every = dependence(both, ratios, valid, cluster, chains, drifts)
    if tested is not None and (tested.length > 1).any():
        alone = directions(law, pairs, single_log_prob_after, able)[1]
        every = np.maximum(every, dependence(both, alone, valid, cluster, chains, drifts))
    z, greatest = [], []
    for length in np.unique(every):
        part = psi[:, every == length]
        own, _, scaled = studentised(part, (part != 0).sum(axis=0) >= MIN_CLUSTERS, chains, int(length))
        if scaled.shape[1]:
            z.append(own)
            greatest.append(np.abs(signs @ scaled).max(axis=1))
    if not z:
        return nothing
    most = np.max(greatest, axis=0)
    return Greatest(p_of_greatest(np.concatenate(z), most, len(names)), most)


def with_trifles(law: Stack, where: Sequence[Location]) -> Stack:
    """Return a law with the first located change of all ranges, and of the share of lost readings."""
    size = {each.aspect: each.size.value for each in reversed(where)}
    changes = {OFFSET: size.get(Aspect.BIAS, 0.0), LOST: -size.get(Aspect.DETECTION, 0.0)}
    return law.at({key: law.get(key) + change for key, change in changes.items() if change})


def _thinned(law: Stack, sample: Sample, rng: np.random.Generator) -> tuple[Sample, Ints]:
    """Return a part of both files of at most `MAX_PINGS` each, and the sample's cluster of each of its pings."""
    rows = [batch.beginnings(MAX_PINGS) for batch in sample.batches]
    cluster = sample.cluster[np.concatenate(rows)]
    recorded = sample.recorded.thin(MAX_PINGS)
    if sample.simulated is None:
        return Sample(recorded, drawn_in_visits(law, recorded, rng)), np.concatenate([cluster, cluster])
    return Sample(recorded, sample.simulated.thin(MAX_PINGS)), cluster


def drawn_in_visits(law: Stack, batch: Batch, rng: np.random.Generator) -> Batch:
    """Return the batch with readings drawn from a law, of which pings of a visit share placement and level.

    Where the law remembers, each reading depends on the one before it in its run. Readings are drawn again from the
    same random numbers until none changes, which takes as many rounds as the longest chain of such readings.
    """
    model, visits = law.build()
    errors = visit_errors(visits, batch, rng)

    def drawing(each: Batch) -> PhysicalLaw:
        return in_visits(law_of(model, each), *errors)

    return sampled_in_order(batch, drawing, rng.random(len(batch)), model.remembers)


def sampled_in_order(batch: Batch, law: Callable[[Batch], EchoLaw], uniform: Floats, remembers: bool) -> Batch:
    """Return the batch with readings drawn from a law that may remember the one before.

    Args:
        batch: pings, and the readings before them to begin with.
        law: law of the pings of a batch.
        uniform: random number of each ping, (n,).
        remembers: whether the law depends on the reading before.
    """
    drawn = batch
    for _ in range(MAX_ROUNDS if remembers else 1):
        before = drawn.reading
        reading = law(drawn).sample(GivenNumbers(uniform))
        drawn = replace(batch, reading=reading, past=_before_each(reading, batch))
        if np.array_equal(reading.range, before.range):
            break
    return drawn


def _before_each(reading: Reading, batch: Batch) -> Reading:
    """Return the reading before each in its run, in the order of the recording, in which visits may alternate."""
    order = np.arange(len(batch)) if batch.row is None else np.argsort(batch.row)
    return previous(reading[order], batch.ping.run[order])[np.argsort(order)]


def directions(
    law: Stack, pairs: Sequence[tuple[Stack, Batch]], log_prob_after: After, tested: Iterable[str] = CATALOGUE
) -> tuple[list[str], Floats]:
    """Return the effect of each direction, and the ratios of both files, (n, directions).

    Where a parameter may change either way, the direction is from one change to the other: the expected ratio does then
    not depend on how widely readings scatter, which careful and careless placement change.

    Args:
        law: describes both files.
        pairs: law that judges each file, and its readings.
        log_prob_after: `joint_log_prob_after` or `single_log_prob_after`.
        tested: effects.
    """
    base = np.concatenate([log_prob_after(each, [{}], batch)[0] for each, batch in pairs])
    names, ratios = [], []
    for name in tested:
        # regressors of time look for what follows the clock, and the aspect of spread for jitter, which the scatter of
        # placements changes too
        if CATALOGUE[name].by_clock or name == JITTER or not _shown(name, pairs[0][1]):
            continue
        every = changes(law, name)
        flat = [change for ends in every for change in ends]
        nats = np.concatenate([log_prob_after(each, flat, batch) for each, batch in pairs], axis=1)
        ends = np.split(nats, np.cumsum([len(each) for each in every])[:-1])
        for each in ends:
            ratio = np.clip(each[-1] - (each[0] if len(each) > 1 else base), -LIMIT_NATS, LIMIT_NATS)
            names.append(name)
            ratios.append(ratio)
    return names, np.stack(ratios, axis=1)


def _shown(name: str, batch: Batch) -> bool:
    effect = CATALOGUE[name]
    return batch.grid_m <= effect.coarsest_step_m and any(
        p.identifiable(batch.ping.covariates) for p in effect.parameters
    )


def changes(law: Stack, name: str) -> list[list[dict[Key, float]]]:
    """Return the changes of an effect to typical sizes: its first parameter varied, the others as they start.

    Each is a pair where the parameter may be less and more, as little and as much, and a single one otherwise.
    """
    first, *others = (law.parameter((name, p.name)) for p in CATALOGUE[name].parameters)
    beside = {(name, p.name): p.starts[0] if p.starts else p.null for p in others if not p.covariate}
    key = (name, first.name)
    if name in law.values:
        step = 0.5 * first.typical if first.typical > 0 else STEP_SHARE * (first.high - first.low)
        groups = [[law.get(key) - step, law.get(key) + step]]
        beside = {key: law.get(key) for key in beside}
    elif first.typical > 0:
        groups = [[first.null - 0.5 * first.typical, first.null + 0.5 * first.typical]]
    else:
        groups = [[value] for value in first.starts if value != first.null]
    inside = [[value for value in group if first.low <= value <= first.high] for group in groups]
    inside = [group for group in inside if group]
    out = [[{key: value, **beside} for value in group] for group in inside]
    places = [p for p in others if len(p.starts) > 1 and not p.covariate] if name not in law.values else []
    for p in places[:1]:  # where a reflector may stand
        out += [
            [{key: value, **beside, (name, p.name): start} for value in group]
            for group in inside
            for start in p.starts[1:]
        ]
    return out


def joint_log_prob_after(law: Stack, every: Sequence[dict[Key, float]], batch: Batch) -> Floats:
    """Return the log probability of each reading, given those before it in its visit, after each change of a law, nats.

    What all pings of a visit share, such as an error of placement or a reflector that is there for the whole visit,
    says little of each ping once the first have shown it.

    Returns:
        Of each change and reading, (changes, n).
    """
    return _after(law, every, lambda model, visits: log_prob(law_of(model, batch), visits, batch, exact=True))


def single_log_prob_after(law: Stack, every: Sequence[dict[Key, float]], batch: Batch) -> Floats:
    """Return the log probability of each reading as a single ping after each change of a law, nats, (changes, n).

    Each ping may have several readings, (k, n), after the same past: (changes, k, n).
    """

    def nats(model: PhysicalModel, visits: VisitEffects) -> Tensor:
        alone = single_ping_law(law_of(model, batch), visits)
        return torch.log(torch.clamp(alone.probability_tensor(batch.reading), min=LEAST_PROBABILITY))

    return _after(law, every, nats)


def _after(law: Stack, every: Sequence[dict[Key, float]], nats: Measure) -> Floats:
    values = np.array([list(change.values()) for change in every], dtype=np.float64)
    return at_each(law, list(every[0]), values, nats)


def _sums(law: Stack, sample: Sample, cluster: Ints, ratios: Floats, n: int, rng: np.random.Generator) -> Floats:
    """Return the sums over clusters of (D - m) (U - g), (clusters, directions)."""
    level = np.concatenate([level_of(ping_law(law, batch)) for batch in sample.batches])
    level = np.clip(level, -20.0, 20.0)
    own = np.stack([level, np.exp(-0.5 * (level / DETECTION_WIDTH_DB) ** 2)], axis=1)
    x = np.stack(list(sample.conditions.values()) or [np.zeros(len(sample.visit))], axis=1)
    units = units_of(sample.visit, np.concatenate([x, np.round(own, 3)], axis=1))
    first = np.unique(units, return_index=True)[1]
    basis = basis_of(x[first], own[first], cluster[first], rng)
    folds = folds_of(cluster[first], rng)
    count = np.add.reduceat(np.ones(len(units)), first)
    recorded = sample.is_recorded[first].astype(np.float64)
    on_conditions = CrossFit(basis.features[:, : basis.n_condition], count, folds, near=False)
    m = np.clip(on_conditions.predict((count * recorded)[:, None])[:, 0], 0.0, 1.0)
    contrast = (recorded - m) * ((m >= OVERLAP[0]) & (m <= OVERLAP[1]))
    sums = np.add.reduceat(ratios, first, axis=0)
    g = CrossFit(basis.features, count, folds, near=True).predict(sums)
    part = contrast[:, None] * (sums - count[:, None] * g)
    return np.stack([np.bincount(cluster[first], column, n) for column in part.T], axis=1)
