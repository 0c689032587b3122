"""Comparison of the rig with the sonar of the thesis by the distances at which each receives no echo.

A network trained with squared error outputs the mean distance of its training pings with the given inputs. For a
reading of 0, an angle, a reflectance and a credence, this is the mean distance of such pings without echo. A sonar
without echo from some distance to the end of the grid at 6 m has this mean m, so the distance is 2 m - 6 m.

The recordings of the thesis were not published, so its published networks are the only reference. They do not determine
the fraction of pings without echo or the scatter of readings, and small networks smooth what they learn. Networks of
the same architecture trained on recordings of the rig show by how much.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from acquisition import ModelError, Ping, Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.laboratory.unit import RANGES
from acquisition.survey.plan import PLANS, THESIS_ANGLES, SurveyPlan
from noise.learned.thesis import ThesisNetwork, load_thesis_network
from training.thesis.data import (
    DISTANCE_SPAN,
    MAX_ANGLE_DEG,
    Bits,
    Floats,
    Samples,
    Singles,
    group_mean,
    is_right,
    metres,
)
from training.thesis.experiment import TrainingJob, train_all
from training.thesis.fit import Recipe
from training.thesis.networks import FlatNetwork

Predictor = Callable[[NDArray[np.floating]], NDArray[np.floating]]
"""From the four rescaled inputs (n, 4) to labels, (n,)."""
Progress = Callable[[int, int], None]
Report = Callable[[str, int, int], None]
ANGLES_DEG = np.array(THESIS_ANGLES)
REFLECTORS = {"mirror": 0.9, "rubber": 0.1}
MAX_DISTANCE = 6.0  # m
NEVER_RIGHT, HALF_RIGHT, HALF_WIDTH = 0.0, 0.5, 0.25  # credences, and half width of the range about a half
KINDS = ("silent", "right", "wrong")  # pings without echo, with a reading within 10 %, with another reading
STATED_GAIN, FULL_GAIN = 14, 31  # gain codes: Esmi (2016), section 4, and the maximum
BANDS = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.01])  # m
HIDDEN = 25  # neurons or cells of the published networks
AUTHOR, OWN = "author", "own"
FREE = ("sensitivity_db", "radius", "yaw")  # properties of a unit that a device does not report
FIRST_STEP = 0.35  # as a fraction of each range
COARSE = replace(PLANS["thesis"], distances_mm=tuple(float(d) for d in range(200, 6001, 200)), pings=4)


@dataclass(frozen=True, eq=False)
class SilentDistances:
    """Mean distances of pings without echo, m, by reflector (`REFLECTORS`) and angle (`ANGLES_DEG`), (2, 11) each.

    Attributes:
        never_right: over conditions with credence 0.
        half_right: over conditions with credence about 0.5; nan if there are none.
    """

    never_right: Floats
    half_right: Floats

    @classmethod
    def of_network(cls, network: Predictor) -> SilentDistances:
        """Evaluate a network."""
        return cls(_predicted(network, NEVER_RIGHT), _predicted(network, HALF_RIGHT))

    @classmethod
    def of_samples(cls, samples: Samples) -> SilentDistances:
        """Average over pings."""
        credence = samples.feature[:, 3]
        half_right = np.abs(credence - HALF_RIGHT) <= HALF_WIDTH
        return cls(_measured(samples, credence == NEVER_RIGHT), _measured(samples, half_right))

    @classmethod
    def mean(cls, members: Sequence[SilentDistances]) -> SilentDistances:
        """Average over networks."""
        return cls(
            *(np.mean([getattr(one, name) for one in members], axis=0) for name in ("never_right", "half_right"))
        )

    def rms_difference(self, other: SilentDistances) -> float:
        """Return the root mean square difference of `never_right`, m; nan counts as 6 m."""
        return float(np.sqrt(np.mean((self._filled() - other._filled()) ** 2)))

    def _filled(self) -> Floats:
        return np.nan_to_num(self.never_right, nan=MAX_DISTANCE)


def _predicted(network: Predictor, credence: float) -> Floats:
    angle, reflectance = np.meshgrid(np.deg2rad(ANGLES_DEG) / np.deg2rad(MAX_ANGLE_DEG), list(REFLECTORS.values()))
    columns = [angle, reflectance, np.zeros(angle.shape), np.full(angle.shape, credence)]
    inputs = np.stack(columns, axis=-1).reshape(-1, 4).astype(np.float32)
    return metres(network(inputs)).reshape(angle.shape)


def _measured(samples: Samples, chosen: Bits) -> Floats:
    """Return the mean distance of the chosen pings without echo, nan if there are none, (2, 11)."""
    column = np.abs(samples.angle_deg[:, None] - ANGLES_DEG).argmin(axis=1)
    row = np.abs(samples.feature[:, 1, None] - list(REFLECTORS.values())).argmin(axis=1)
    silent, shape = chosen & (samples.range == 0.0), (len(REFLECTORS), len(ANGLES_DEG))
    place = np.ravel_multi_index((row[silent], column[silent]), shape)
    return group_mean(samples.distance[silent], place, shape[0] * shape[1]).reshape(shape)


def ping_kinds(samples: Samples) -> dict[str, Bits]:
    """Return which pings are of each of `KINDS`, (n,)."""
    silent, right = samples.range == 0.0, is_right(samples.range, samples.distance)
    return dict(zip(KINDS, (silent, right & ~silent, ~right & ~silent), strict=True))


@dataclass(frozen=True, eq=False)
class NetworkErrors:
    """Errors of a network on pings.

    Attributes:
        loss: mean squared error of rescaled distances, as in the thesis.
        by_kind: root mean square error for each of `KINDS`, m; nan if there are none.
    """

    loss: float
    by_kind: dict[str, float]

    @classmethod
    def of(cls, network: Predictor, samples: Samples) -> NetworkErrors:
        """Evaluate a network."""
        error = np.asarray(network(samples.feature), dtype=np.float64) - samples.label
        by_kind = {name: _root_mean_square(error[rows]) for name, rows in ping_kinds(samples).items()}
        return cls(float(np.mean(error**2)), by_kind)

    @classmethod
    def mean(cls, members: Sequence[NetworkErrors]) -> NetworkErrors:
        """Average over networks."""
        by_kind = {name: float(np.mean([one.by_kind[name] for one in members])) for name in KINDS}
        return cls(float(np.mean([one.loss for one in members])), by_kind)


def _root_mean_square(error: Floats) -> float:
    return DISTANCE_SPAN * float(np.sqrt(np.mean(error**2))) if len(error) else float("nan")


def mean_offset(network: Predictor, samples: Samples, edges: Floats) -> Floats:
    """Return the mean error of a network on right readings in bands of distance, m, positive for too far, (k,).

    Args:
        network: any network.
        samples: pings.
        edges: edges of the bands, m, (k + 1,).
    """
    right = ping_kinds(samples)["right"]
    error = metres(np.asarray(network(samples.feature[right]))) - samples.distance[right]
    band = np.digitize(samples.distance[right], edges) - 1
    return np.array([error[band == k].mean() if (band == k).any() else np.nan for k in range(len(edges) - 1)])


def survey(rig: Rig, plan: SurveyPlan, seed: int, progress: Progress | None = None) -> Recording:
    """Record a plan that varies only distance, angle and reflector with a rig."""
    parts = [plan.ping(number) for number in range(len(plan))]
    names = ("distance", "angle", "incidence", "reflectance", "time", "run")
    ping = Ping.of(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    return rig.record(ping, np.random.default_rng(seed), progress)


@dataclass(frozen=True)
class TunedUnit:
    """A unit with fitted electronics.

    Attributes:
        unit: the unit.
        misfit: root mean square difference of the distances without echo from the thesis's on the coarse survey, m.
        trials: number of units evaluated.
    """

    unit: Unit
    misfit: float
    trials: int

    @property
    def at_limit(self) -> tuple[str, ...]:
        """Names of the properties at a limit of their range."""
        return tuple(n for n, s in zip(FREE, _fractions(self.unit), strict=True) if min(s, 1.0 - s) < 0.01)


def tuned(
    setup: Setup,
    target: SilentDistances,
    trials: int,
    seed: int,
    progress: Progress = lambda done, total: None,
    plan: SurveyPlan = COARSE,
) -> TunedUnit:
    """Fit the free properties of the nominal unit to the distances without echo (Nelder and Mead).

    Args:
        setup: the laboratory.
        target: distances without echo of the thesis's sonar.
        trials: maximum number of surveys.
        seed: seed of every survey, so that trials differ only by the unit.
        progress: called after each trial with the completed and the maximum number.
        plan: plan of a survey.
    """
    tried: list[tuple[float, Unit]] = []

    def misfit(fractions: Floats) -> float:
        if len(tried) >= trials:
            return min(tried, key=lambda pair: pair[0])[0]
        unit = _unit(fractions)
        silent = SilentDistances.of_samples(Samples.of(survey(Rig(unit, setup), plan, seed)))
        tried.append((silent.rms_difference(target), unit))
        progress(len(tried), trials)
        return tried[-1][0]

    start = _fractions(Unit.nominal())
    corners = np.vstack([start, start + FIRST_STEP * np.eye(len(FREE)) * np.where(start > 0.5, -1.0, 1.0)])
    options: Any = {"initial_simplex": corners, "maxfev": trials, "xatol": 0.01, "fatol": 2e-3}
    minimize(misfit, start, method="Nelder-Mead", bounds=[(0.0, 1.0)] * len(FREE), options=options)
    best = min(tried, key=lambda pair: pair[0])
    return TunedUnit(best[1], best[0], len(tried))


def _unit(fractions: Floats) -> Unit:
    """Return the nominal unit with its free properties at fractions of their ranges."""
    limits = (RANGES[name] for name in FREE)
    values = {n: low + f * (high - low) for n, f, (low, high) in zip(FREE, fractions, limits, strict=True)}
    return replace(Unit.nominal(), **values)


def _fractions(unit: Unit) -> Floats:
    return np.array([(getattr(unit, n) - RANGES[n][0]) / (RANGES[n][1] - RANGES[n][0]) for n in FREE])


@dataclass(frozen=True)
class StudySettings:
    """Extent of the study.

    Attributes:
        networks: folder of trained networks.
        trials: units to evaluate at each gain; 0 uses the nominal unit only.
        pings: pings per condition.
        seeds: number of trainings of each network on each recording.
        epochs: passes of training.
        seed: seed of the recordings.
    """

    networks: Path
    trials: int = 40
    pings: int = 50
    seeds: int = 3
    epochs: int = 15
    seed: int = 1


@dataclass(frozen=True, eq=False)
class RigVariant:
    """A rig's recording of the thesis's survey.

    Attributes:
        name: name of the rig.
        rig: the rig.
        samples: its recording.
        author: the published networks.
        own: networks trained on the recording.
    """

    name: str
    rig: Rig
    samples: Samples
    author: list[Predictor]
    own: list[Predictor]

    @cached_property
    def silent(self) -> SilentDistances:
        """Distances without echo of the recording."""
        return SilentDistances.of_samples(self.samples)

    @cached_property
    def smoothed(self) -> SilentDistances:
        """Distances without echo according to the networks trained on the recording."""
        return SilentDistances.mean([SilentDistances.of_network(network) for network in self.own])

    @cached_property
    def shares(self) -> Floats:
        """Fraction of pings of each of `KINDS`, (3,)."""
        return np.array([rows.mean() for rows in ping_kinds(self.samples).values()])

    def errors(self, source: str) -> NetworkErrors:
        """Return the mean errors of the networks of a source (`AUTHOR`, `OWN`) on this recording."""
        return NetworkErrors.mean([NetworkErrors.of(network, self.samples) for network in getattr(self, source)])

    def offsets(self, source: str) -> Floats:
        """Return the mean error of the networks of a source on right readings, m, in each of `BANDS`, (7,)."""
        return np.mean([mean_offset(network, self.samples, BANDS) for network in getattr(self, source)], axis=0)


@dataclass(frozen=True, eq=False)
class RigStudy:
    """Results of the comparison.

    Attributes:
        author: distances without echo of the published networks, by name.
        variants: rigs.
        tunings: fitted units, by gain.
    """

    author: dict[str, SilentDistances]
    variants: list[RigVariant]
    tunings: dict[int, TunedUnit]

    @cached_property
    def target(self) -> SilentDistances:
        """Mean over the published networks."""
        return SilentDistances.mean(list(self.author.values()))


def published(folder: Path) -> dict[str, ThesisNetwork]:
    """Return the published networks in a folder, by name.

    Raises:
        ModelError: there are none.
    """
    paths = sorted([*folder.glob("*.h5"), *folder.glob("*.hdf5")])
    if not paths:
        raise ModelError(f"{folder}: contains no *.h5 or *.hdf5; get the networks of github.com/speloot/MasterThesis")
    networks = [load_thesis_network(path) for path in paths]
    return {_name(path, network): network for path, network in zip(paths, networks, strict=True)}


def _name(path: Path, network: ThesisNetwork) -> str:
    versions = {"weights": "best weights", "my_model": "last weights"}
    return f"{network.kind.upper()}, {next((text for key, text in versions.items() if key in path.stem), path.stem)}"


def study(networks: dict[str, ThesisNetwork], settings: StudySettings, report: Report) -> RigStudy:
    """Fit units, record surveys and train networks at both gains.

    Args:
        networks: published networks by name.
        settings: extent of the study.
        report: called with the name of a task, and its completed and total steps.
    """
    author = {name: SilentDistances.of_network(network.output) for name, network in networks.items()}
    outcome = RigStudy(author, [], {})
    for gain in (STATED_GAIN, FULL_GAIN):
        setup, units = Setup(gain=gain), {"nominal": Unit.nominal()}
        if settings.trials:
            progress = _progress(report, f"gain {gain}, tuning")
            outcome.tunings[gain] = tuned(setup, outcome.target, settings.trials, settings.seed, progress)
            units["tuned"] = outcome.tunings[gain].unit
        for name, unit in units.items():
            outcome.variants.append(_variant(f"gain {gain}, {name}", Rig(unit, setup), networks, settings, report))
    return outcome


def _variant(
    name: str, rig: Rig, networks: dict[str, ThesisNetwork], settings: StudySettings, report: Report
) -> RigVariant:
    """Record the thesis's survey with a rig and train networks like the author's on it."""
    plan = replace(PLANS["thesis"], pings=settings.pings)
    samples = Samples.of(survey(rig, plan, settings.seed, _progress(report, name)))
    recipe, seeds = Recipe(epochs=settings.epochs), range(settings.seeds)
    jobs = [TrainingJob(FlatNetwork(kind, HIDDEN), recipe, seed) for kind in ("mlp", "lstm") for seed in seeds]
    progress = _progress(report, f"{name}, training")
    results = train_all(jobs, samples, settings.networks, lambda job, done, total: progress(done, total))
    own = [_predictor(job, results[job].theta) for job in jobs]
    return RigVariant(name, rig, samples, [network.output for network in networks.values()], own)


def _predictor(job: TrainingJob, theta: Singles) -> Predictor:
    return lambda feature: job.network.predict(theta, feature.astype(np.float32))


def _progress(report: Report, task: str) -> Progress:
    return lambda done, total: report(task, done, total)
