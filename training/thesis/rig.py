"""Comparison of the simulated rig with the sonar of the thesis, through the networks that its author published.

The rig's unknown electronics are tuned, within the limits between which units are drawn, until it is silent where the
thesis's sonar was. Networks of the author's architecture are trained on each of the rig's recordings, which shows how
much a network smooths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.optimize import minimize

from acquisition import ModelError, Ping, Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.laboratory.unit import RANGES
from acquisition.survey.plan import PLANS, SurveyPlan
from noise.learned.thesis import ThesisNetwork, load_thesis_network
from training.common.progress import OnProgress
from training.thesis.data import Floats, Samples
from training.thesis.experiment import TrainingJob, train_all
from training.thesis.fit import Fitted, Recipe
from training.thesis.networks import FlatNetwork
from training.thesis.surfaces import PredictionErrors, Predictor, SilentDistances, kinds, mean_offsets

STATED_GAIN, FULL_GAIN = 14, 31  # gain codes: stated in Esmi (2016), section 4; the maximum
BANDS_M = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.01])
HIDDEN_UNITS = 25  # neurons or cells of the author's networks
FREE_PARAMETERS = ("sensitivity_db", "radius", "yaw")  # of a unit: sensitivity, piston radius, misalignment
INITIAL_STEP = 0.35  # share of each range
COARSE = replace(PLANS["thesis"], distances_mm=tuple(float(d) for d in range(200, 6001, 200)), pings=4)
Progress = Callable[[int, int], None]
Source = Literal["author", "own"]
"""Networks of the thesis's author, or those trained on a recording of the rig."""


@dataclass(frozen=True)
class Settings:
    """Extent of the comparison.

    Attributes:
        networks: folder for trained networks.
        trials: units to try at each gain; 0 does not tune.
        pings: per condition.
        seeds: number of trainings of each network on each recording.
        epochs: passes of training.
        seed: of the recordings.
    """

    networks: Path
    trials: int = 40
    pings: int = 50
    seeds: int = 3
    epochs: int = 15
    seed: int = 1


@dataclass(frozen=True, eq=False)
class RigVariant:
    """A rig with its recording of the thesis's survey.

    Attributes:
        name: gain and unit.
        rig: unit and setup.
        samples: recorded pings.
        networks: predictors by source.
    """

    name: str
    rig: Rig
    samples: Samples
    networks: dict[Source, list[Predictor]]

    @cached_property
    def silence(self) -> SilentDistances:
        """Mean distances of the recorded silent pings."""
        return SilentDistances.of_samples(self.samples)

    @cached_property
    def predicted_silence(self) -> SilentDistances:
        """Mean distances of silent pings as predicted by the networks trained on the recording."""
        return SilentDistances.mean([SilentDistances.of_network(network) for network in self.networks["own"]])

    @cached_property
    def shares(self) -> Floats:
        """Share of pings of each of `KINDS`, (3,)."""
        return np.array([rows.mean() for rows in kinds(self.samples).values()])

    def errors(self, source: Source) -> PredictionErrors:
        """Return the errors of networks on this recording: means over networks."""
        return PredictionErrors.mean([PredictionErrors.of(network, self.samples) for network in self.networks[source]])

    def offsets(self, source: Source) -> Floats:
        """Return the mean errors of networks on correct readings by `BANDS_M`, m: means over networks."""
        return np.mean([mean_offsets(network, self.samples, BANDS_M) for network in self.networks[source]], axis=0)


@dataclass(frozen=True)
class TuningResult:
    """A unit with tuned free parameters.

    Attributes:
        unit: the best unit found.
        misfit: root mean square difference of its silent distances from the target, m, on the coarse survey.
        trials: number of units tried.
    """

    unit: Unit
    misfit: float
    trials: int

    @property
    def at_limit(self) -> tuple[str, ...]:
        """Names of the parameters at a limit of their range, which might fit better outside it."""
        shares = zip(FREE_PARAMETERS, _shares_of(self.unit), strict=True)
        return tuple(name for name, share in shares if min(share, 1.0 - share) < 0.01)


@dataclass(frozen=True, eq=False)
class RigStudy:
    """Results of the comparison.

    Attributes:
        predictions: silent distances predicted by the author's networks, by name.
        variants: rigs.
        tunings: tuned units by gain.
    """

    predictions: dict[str, SilentDistances]
    variants: list[RigVariant]
    tunings: dict[int, TuningResult]

    @cached_property
    def target(self) -> SilentDistances:
        """Mean prediction of the author's networks."""
        return SilentDistances.mean(list(self.predictions.values()))


def published(folder: Path) -> dict[str, ThesisNetwork]:
    """Return the networks in a folder by name.

    Raises:
        ModelError: the folder has no network files.
    """
    paths = sorted([*folder.glob("*.h5"), *folder.glob("*.hdf5")])
    if not paths:
        raise ModelError(f"{folder}: contains no *.h5 or *.hdf5; get the networks of github.com/speloot/MasterThesis")
    networks = [load_thesis_network(path) for path in paths]
    return {_name(path, network): network for path, network in zip(paths, networks, strict=True)}


def _name(path: Path, network: ThesisNetwork) -> str:
    versions = {"weights": "best weights", "my_model": "last weights"}
    version = next((text for key, text in versions.items() if key in path.stem), path.stem)
    return f"{network.kind.upper()}, {version}"


def compare(author: dict[str, ThesisNetwork], settings: Settings, report: OnProgress) -> RigStudy:
    """Tune the rig at both gains, record the survey and train networks.

    Args:
        author: the author's networks by name.
        settings: extent of the comparison.
        report: called with the name of the current task, its completed steps and their total.
    """
    predictions = {name: SilentDistances.of_network(network.output) for name, network in author.items()}
    study = RigStudy(predictions, [], {})
    predictors: list[Predictor] = [network.output for network in author.values()]
    for gain in (STATED_GAIN, FULL_GAIN):
        setup, units = Setup(gain=gain), {"nominal": Unit.nominal()}
        if settings.trials:
            progress = _progress(report, f"gain {gain}, tuning")
            study.tunings[gain] = tune(setup, study.target, settings.trials, settings.seed, progress)
            units["tuned"] = study.tunings[gain].unit
        for name, unit in units.items():
            study.variants.append(
                record_variant(f"gain {gain}, {name}", Rig(unit, setup), predictors, settings, report)
            )
    return study


def _progress(report: OnProgress, task: str) -> Progress:
    return lambda done, total: report(task, done, total)


def record_variant(name: str, rig: Rig, author: list[Predictor], settings: Settings, report: OnProgress) -> RigVariant:
    """Record the thesis's survey with a rig and train networks of the author's architectures on it."""
    plan = replace(PLANS["thesis"], pings=settings.pings)
    samples = Samples.of(record_survey(rig, plan, settings.seed, _progress(report, name)))
    recipe, seeds = Recipe(epochs=settings.epochs), range(settings.seeds)
    jobs = [TrainingJob(FlatNetwork(kind, HIDDEN_UNITS), recipe, seed) for kind in ("mlp", "lstm") for seed in seeds]
    training = _progress(report, f"{name}, training")
    fitted = train_all(jobs, samples, settings.networks, lambda job, done, total: training(done, total))
    own = [_predictor(job.network, fitted[job]) for job in jobs]
    return RigVariant(name, rig, samples, {"author": author, "own": own})


def _predictor(network: FlatNetwork, fitted: Fitted) -> Predictor:
    return lambda feature: network.predict(fitted.theta, feature.astype(np.float32))


def record_survey(rig: Rig, plan: SurveyPlan, seed: int, progress: Progress | None = None) -> Recording:
    """Return a rig's recording of a plan that varies only distance, angle and reflector."""
    parts = [plan.ping(number) for number in range(len(plan))]
    names = ("distance", "angle", "incidence", "reflectance", "time", "run")
    ping = Ping.of(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    return rig.record(ping, np.random.default_rng(seed), progress)


def tune(
    setup: Setup,
    target: SilentDistances,
    trials: int,
    seed: int,
    progress: Progress = lambda done, total: None,
    plan: SurveyPlan = COARSE,
) -> TuningResult:
    """Fit the free parameters of the nominal unit to the distances of silent pings (Nelder and Mead).

    Args:
        setup: gain and environment.
        target: silent distances of the thesis's sonar.
        trials: maximum number of surveys.
        seed: of every survey, so that trials differ only by the unit.
        progress: called after each trial.
        plan: survey of a trial.
    """
    tried: list[tuple[float, Unit]] = []

    def misfit(shares: Floats) -> float:
        if len(tried) >= trials:
            return _best(tried)[0]
        unit = _unit_of(shares)
        silence = SilentDistances.of_samples(Samples.of(record_survey(Rig(unit, setup), plan, seed)))
        tried.append((silence.rms_difference(target), unit))
        progress(len(tried), trials)
        return tried[-1][0]

    start = _shares_of(Unit.nominal())
    steps = INITIAL_STEP * np.eye(len(start)) * np.where(start > 0.5, -1.0, 1.0)
    options: Any = {
        "initial_simplex": np.vstack([start, start + steps]),
        "maxfev": trials,
        "xatol": 0.01,
        "fatol": 2e-3,
    }
    minimize(misfit, start, method="Nelder-Mead", bounds=[(0.0, 1.0)] * len(start), options=options)
    best, unit = _best(tried)
    return TuningResult(unit, best, len(tried))


def _best(tried: list[tuple[float, Unit]]) -> tuple[float, Unit]:
    return min(tried, key=lambda pair: pair[0])


def _unit_of(shares: Floats) -> Unit:
    """Return the nominal unit with its free parameters at shares of their ranges."""
    limits = zip(FREE_PARAMETERS, shares, strict=True)
    values = {name: RANGES[name][0] + s * (RANGES[name][1] - RANGES[name][0]) for name, s in limits}
    return replace(Unit.nominal(), **values)


def _shares_of(unit: Unit) -> Floats:
    limits = [(getattr(unit, name), *RANGES[name]) for name in FREE_PARAMETERS]
    return np.array([(value - low) / (high - low) for value, low, high in limits])
