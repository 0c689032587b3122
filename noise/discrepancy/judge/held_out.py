"""Scores on visits that no estimate used: the user's simulation, the emulator, the corrected model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.stats import t as student

from acquisition.arrays import Floats, Ints
from acquisition.ping import CREDENCE_TOLERANCE
from noise.discrepancy.baseline.forest import Grown, floored_log_prob
from noise.discrepancy.baseline.sources import Baseline
from noise.discrepancy.locate.directed import drawn_in_visits
from noise.discrepancy.moments.sample import Sample, positions
from noise.discrepancy.name.estimates import Z
from noise.discrepancy.name.hypothesis import standard_error
from noise.discrepancy.result import LEVEL, HeldOut, Interval, Score
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.metrics import ClusterMean, crps_with_silence
from noise.model import MAX_RANGE, SonarModel

BEYOND = 0.5 + LEVEL / 2.0  # probability of no gain by chance
MIN_MEMBERS = 4  # readings under one condition that stand for the simulation there


def crps(model: SonarModel, batch: Batch) -> float:
    """Return the mean CRPS of a model's readings with silence counted, m."""
    return float(np.mean(crps_of_each(model, batch)))


def crps_of_each(model: SonarModel, batch: Batch, tolerance: float | None = None) -> Floats:
    """Return the CRPS of each reading with silence counted, m, (n,); see `crps_with_silence` on the tolerance."""
    return np.asarray(crps_with_silence(model.law(batch.ping, batch.past), batch.reading, tolerance=tolerance))


@dataclass(frozen=True, eq=False)
class Simulation:
    """The user's own simulation: a model, and its readings where they were given as a file.

    Readings under the same condition are the simulation itself; a model of them only stands for it elsewhere: a forest
    of them or the emulator, whichever predicts the recording better. What it misses of simulated visits that it has not
    seen is not counted against the simulation.

    Attributes:
        model: the given model, or the one that stands for the readings.
        readings: None where the model itself is the simulation.
        excess: mean CRPS of the model beyond that of the simulation, m, with its standard error.
        near_excess: the same of the CRPS within the tolerance of credence.
        tolerance: of the CRPS, a share of the true distance; see `crps_with_silence`.
        forest: of the readings; None where the model is none.
        law: of the emulator; None where the model is none.
    """

    model: SonarModel
    readings: Batch | None = None
    excess: tuple[float, float] = (0.0, 0.0)
    near_excess: tuple[float, float] = (0.0, 0.0)
    tolerance: float | None = None
    forest: Grown | None = None
    law: Stack | None = None

    @classmethod
    def of(cls, base: Baseline, recorded: Batch, rng: np.random.Generator) -> Simulation:
        """Return the simulation of a baseline that a recording is compared with.

        Args:
            base: the simulation.
            recorded: readings of the recording.
            rng: draws visits under the simulation's law.
        """
        grown = base.forest
        if grown is None or base.before is not grown.model:
            return cls(base.before)
        model, score, few = base.before, grown.crps_within, grown.batch
        forest: Grown | None = grown
        if base.held_out is not None and crps(base.emulator, recorded) < crps(model, recorded):
            model, forest, few = base.emulator, None, few.select(np.isin(few.condition, base.held_out.condition))
            score = partial(crps_of_each, model, few)
        drawn = drawn_in_visits(base.law, grown.batch, rng)
        excess, near = (_excess(few, score(each), base.law, drawn, each) for each in (None, CREDENCE_TOLERANCE))
        return cls(model, base.readings, excess, near, forest=forest, law=base.law if forest is None else None)

    @cached_property
    def near(self) -> Simulation:
        """The same, scored within the tolerance of credence: readings that are no use all count alike."""
        return replace(self, excess=self.near_excess, tolerance=CREDENCE_TOLERANCE)

    def elsewhere(self, batch: Batch) -> SonarModel:
        """Return the model of readings of the recording as it is without simulated readings of their places."""
        if self.forest is not None:
            return self.forest.elsewhere()
        if self.law is None:
            return self.model
        return self.law.by_part(part_of_place(self.law, batch, self.readings)).single_ping_model

    def crps_of_each(self, batch: Batch) -> Floats:
        """Return the CRPS of each reading with silence counted, m, (n,); an estimate where it has no readings."""
        return self._scored(batch)[0]

    @cached_property
    def _scores(self) -> dict[Batch, tuple[Floats, float]]:
        """What has been scored: several models are compared with the simulation on the same readings."""
        return {}

    def _scored(self, batch: Batch) -> tuple[Floats, float]:
        """Return the CRPS of each reading, m, (n,), and the standard error of their sum where they are estimates, m."""
        if batch not in self._scores:
            known, error = self._by_readings(batch), 0.0
            estimated = np.isnan(known)
            if estimated.any():
                known[estimated] = (crps_of_each(self.model, batch, self.tolerance) - self.excess[0])[estimated]
                error = float(estimated.sum() * self.excess[1])
            self._scores[batch] = known, error
        return self._scores[batch]

    def _by_readings(self, batch: Batch) -> Floats:
        """Return the CRPS of each reading by those under its condition, m, (n,); NaN where there are too few."""
        out = np.full(len(batch), np.nan)
        if self.readings is None:
            return out
        places = [positions(each)[each.visit] for each in (self.readings, batch)]
        place = np.unique(np.concatenate(places), axis=0, return_inverse=True)[1].ravel()
        own, asked = np.split(place, [len(self.readings)])
        every, value = (ends(each, self.tolerance) for each in (self.readings, batch))
        for k in np.intersect1d(asked, own):
            members = every[own == k]
            if len(members) >= MIN_MEMBERS:
                out[asked == k] = fair_crps(value[asked == k], members)
        return out

    def gain(self, *scored: tuple[Batch, Floats]) -> Floats:
        """Return what other predictions of batches, with CRPS (n,), gain on each unit, m."""
        return np.concatenate([batch.unit_sums(self._scored(batch)[0] - crps) for batch, crps in scored])

    def gain_on(self, other: Simulation, batch: Batch) -> Floats:
        """Return the gain over another on each unit of a batch, m, under conditions for which both have readings."""
        return batch.unit_sums(np.nan_to_num(other._by_readings(batch) - self._by_readings(batch)))

    def error(self, *scored: tuple[Batch, Floats]) -> float:
        """Return the standard error of the sum of gains, m, as far as the scores of the simulation are estimates."""
        return sum(self._scored(batch)[1] for batch, _ in scored)

    def has_any_of(self, batch: Batch) -> bool:
        """Return whether there are readings under any condition of a batch."""
        return not np.isnan(self._by_readings(batch)).all()

    def is_beaten(self, *scored: tuple[Batch, Floats]) -> bool:
        """Return whether other predictions of batches, with CRPS (n,), are better beyond chance."""
        return beyond_chance(self.gain(*scored), self.error(*scored))


def part_of_place(law: Stack, batch: Batch, readings: Batch | None) -> Ints:
    """Return the part of the simulation's readings that holds the place of each reading of the recording, (n,).

    A law `by_part` of these is as it is without simulated readings of the places.

    Args:
        law: of the simulation.
        batch: readings of the recording.
        readings: of the simulation; None where its law is known exactly.
    """
    return Sample(batch, readings).left_out(law)[0]


def beyond_chance(gain: Floats, error: float = 0.0) -> bool:
    """Return whether the sum of the gains of visits, (n,), is more than chance, by Student's t.

    Args:
        gain: of each visit.
        error: further standard error of the sum.
    """
    limit = student.ppf(BEYOND, max(len(gain) - 1, 1))
    return bool(gain.sum() > limit * np.hypot(standard_error(gain), error))


def improves(gain: Floats, near: Floats, error: float = 0.0) -> bool:
    """Return whether a correction that is certain for another reason may be trusted to predict no worse.

    Where silence counts, a few missed echoes decide the CRPS. It must not be worse beyond chance, and what it gains
    within the tolerance of credence, where these count little, must be no loss.

    Args:
        gain: in the CRPS, of each visit.
        near: in the CRPS within the tolerance of credence, of each visit.
        error: further standard error of the sum of the gains.
    """
    return bool(near.sum() >= 0.0) and not beyond_chance(-gain, error)


def ends(batch: Batch, tolerance: float | None = None) -> Floats:
    """Return the error of each reading, m, (n,); that of the end of the register where there is no echo.

    With a tolerance, errors are clipped to so much of the distance; see `crps_with_silence`.
    """
    error = np.where(batch.reading.echo, batch.error, MAX_RANGE - batch.ping.distance)
    reach = np.inf if tolerance is None else tolerance * batch.ping.distance
    return np.clip(error, -reach, reach)


def _excess(batch: Batch, crps: Floats, law: Stack, drawn: Batch, tolerance: float | None) -> tuple[float, float]:
    """Return the mean CRPS of a model beyond that of the simulation, m, with its standard error.

    Readings of one visit predict each other better than any law of the simulation predicts them, as they share the
    placement of the target and its level. What that gains on readings drawn from a law is no error of the model.
    Without visits of several readings the excess is unknown, and 0 as if the model were the simulation.

    Args:
        batch: readings of the simulation.
        crps: of the model, m, (n,).
        law: of the simulation.
        drawn: readings drawn from it.
        tolerance: of the CRPS.
    """
    found = _beyond_repeatability(batch, crps, tolerance)
    by_visit = _beyond_repeatability(drawn, crps_of_each(law.single_ping_model, drawn, tolerance), tolerance)
    if found is None or by_visit is None:
        return 0.0, 0.0
    return max(found[0] - by_visit[0], 0.0), float(np.hypot(found[1], by_visit[1]))


def _beyond_repeatability(batch: Batch, crps: Floats, tolerance: float | None) -> tuple[float, float] | None:
    """Return the mean of a CRPS, (n,), beyond that of the readings by the others of their visit, m, with its error.

    None where no visit has several readings.
    """
    value = ends(batch, tolerance)
    own = [np.full(len(rows), repeatability(value[rows])) for rows in batch.visit_rows]
    beyond = crps - np.concatenate(own)
    known = ~np.isnan(beyond)
    if not known.any():
        return None
    mean = ClusterMean.of(beyond[known], batch.visit[known])
    return mean.mean, float(np.nan_to_num(mean.error))


def repeatability(value: Floats) -> Floats:
    """Return the mean CRPS of readings of one visit, m, each predicted by the others; NaN for a single one.

    Args:
        value: readings of a visit along the last axis, (..., n).
    """
    n = value.shape[-1]
    rank = 2.0 * np.arange(n) - n + 1.0
    return np.sum(rank * np.sort(value), axis=-1) / (n * (n - 1.0) if n > 1 else np.nan)


def fair_crps(value: Floats, members: Floats) -> Floats:
    """Return the CRPS of values given an ensemble, (n,), unbiased for the law that the members are drawn from.

    The estimator is that of Ferro (2014).

    Args:
        value: (n,).
        members: at least two for all values, (m,), or for each, (n, m).
    """
    return np.asarray(np.abs(value[:, None] - members).mean(axis=-1) - repeatability(members))


def log_score(model: SonarModel, batch: Batch) -> Floats:
    """Return the log probability of each reading, nats, (n,), with a floor for what a law calls impossible."""
    return floored_log_prob(model.law(batch.ping, batch.past), batch)


def held_out(
    before: Simulation,
    emulator: SonarModel,
    after: SonarModel,
    itself: SonarModel,
    unseen: Batch,
) -> HeldOut:
    """Return the scores on unseen visits.

    Args:
        before: the user's own simulation.
        emulator: law that describes it.
        after: the corrected model.
        itself: the recording's other visits as a law, which shows how well it repeats itself.
        unseen: readings to score.
    """
    models = (before.model, emulator, after)
    nats = [log_score(model, unseen) for model in models]
    # what is known of few conditions may be taken for more than there is; no score is negative
    errors = [max(float(before.crps_of_each(unseen).mean()), 0.0), crps(emulator, unseen), crps(after, unseen)]
    if after is before.model:
        errors[2] = errors[0]
    scores = [Score(float(n.mean()), error) for n, error in zip(nats, errors, strict=True)]
    gain = unseen.unit_sums(nats[2] - nats[0])
    mean, error = float(gain.sum()) / len(unseen), Z * standard_error(gain) / len(unseen)
    gained = Interval(mean, mean - error, mean + error, "nats")
    return HeldOut(len(unseen), unseen.n_visits, scores[0], scores[1], scores[2], crps(itself, unseen), gained)
