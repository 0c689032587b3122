"""The rig beside the thesis's own sonar: its recordings of the thesis's survey, and what networks make of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from acquisition import ModelError
from acquisition.bench import Rig, Setup, Unit
from acquisition.survey.plan import PLANS
from noise.learned.thesis import ThesisNetwork, load_thesis_network
from training.thesis.data import Floats, Samples, Singles
from training.thesis.fit import Recipe
from training.thesis.networks import Network
from training.thesis.runs import Job, train_all
from training.thesis.silence import Answer, Errors, Silence, kinds, middle, offset
from training.thesis.tuning import Tuned, survey, tuned

STATED, FULL = 14, 31  # gain codes: Esmi (2016), section 4, and the greatest
BANDS_M = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.01])
UNITS = 25  # neurons, or cells, of the author's networks
AUTHOR, OWN = "author", "own"
Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Settings:
    """How much is done.

    Attributes:
        networks: where networks are kept that were trained.
        trials: units to try at each gain; none leaves the electronics as they are.
        pings: a condition.
        seeds: how often each network is trained on each recording.
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
class Case:
    """A rig's recording of the thesis's survey.

    Attributes:
        name: of the rig.
        rig: it.
        samples: what it recorded.
        networks: what answers, by name; first the author's, then those that were trained on this recording.
        author: how many of these are the author's.
    """

    name: str
    rig: Rig
    samples: Samples
    networks: dict[str, Answer]
    author: int

    @cached_property
    def silence(self) -> Silence:
        """Where the rig was silent."""
        return Silence.of_samples(self.samples)

    @cached_property
    def blurred(self) -> Silence:
        """Where it was, as networks tell it that were trained on the recording."""
        return middle([Silence.of_network(network) for network in self._of(OWN)])

    @cached_property
    def shares(self) -> Floats:
        """Share of pings of each of `KINDS`, (3,)."""
        return np.array([which.mean() for which in kinds(self.samples).values()])

    def errors(self, whose: str) -> Errors:
        """Return how the author's networks, or its own, fare on this recording: means over networks."""
        return Errors.mean([Errors.of(network, self.samples) for network in self._of(whose)])

    def offsets(self, whose: str) -> Floats:
        """Return by how much right readings are put farther than they were, m, over `BANDS_M`: means over networks."""
        return np.mean([offset(network, self.samples, BANDS_M) for network in self._of(whose)], axis=0)

    def _of(self, whose: str) -> list[Answer]:
        every = list(self.networks.values())
        return every[: self.author] if whose == AUTHOR else every[self.author :]


@dataclass(frozen=True, eq=False)
class Study:
    """Everything that is compared.

    Attributes:
        answers: of the author's networks to silence, by name.
        cases: rigs.
        tunings: how the electronics were turned, by gain.
    """

    answers: dict[str, Silence]
    cases: list[Case]
    tunings: dict[int, Tuned]

    @cached_property
    def target(self) -> Silence:
        """Mean of what the author's networks answer."""
        return middle(list(self.answers.values()))


def published(folder: Path) -> dict[str, ThesisNetwork]:
    """Return the networks of a folder by name.

    Raises:
        ModelError: there are none.
    """
    paths = sorted([*folder.glob("*.h5"), *folder.glob("*.hdf5")])
    if not paths:
        raise ModelError(f"{folder}: holds no *.h5 or *.hdf5; get the networks of github.com/speloot/MasterThesis")
    networks = [load_thesis_network(path) for path in paths]
    return {_name(path, network): network for path, network in zip(paths, networks, strict=True)}


def _name(path: Path, network: ThesisNetwork) -> str:
    kept = {"weights": "best weights", "my_model": "last weights"}
    return f"{network.kind.upper()}, {next((text for key, text in kept.items() if key in path.stem), path.stem)}"


def compared(author: dict[str, ThesisNetwork], settings: Settings, report: Report) -> Study:
    """Tune, record and train.

    Args:
        author: his networks by name.
        settings: how much.
        report: called with what is done, how far it is, and how much there is of it.
    """
    answers = {name: Silence.of_network(network.output) for name, network in author.items()}
    tunings, cases = dict[int, Tuned](), list[Case]()
    for gain in (STATED, FULL):
        setup, units = Setup(gain=gain), {"nominal": Unit.nominal()}
        if settings.trials:
            tell = _teller(report, f"gain {gain}, tuning")
            tunings[gain] = tuned(setup, middle(list(answers.values())), settings.trials, settings.seed, tell)
            units["tuned"] = tunings[gain].unit
        for name, unit in units.items():
            cases.append(case(f"gain {gain}, {name}", Rig(unit, setup), author, settings, report))
    return Study(answers, cases, tunings)


def case(name: str, rig: Rig, author: dict[str, ThesisNetwork], settings: Settings, report: Report) -> Case:
    """Record the thesis's survey with a rig and train networks like the author's on it."""
    plan = replace(PLANS["thesis"], pings=settings.pings)
    samples = Samples.of(survey(rig, plan, settings.seed, _teller(report, name)))
    recipe, seeds = Recipe(epochs=settings.epochs), range(settings.seeds)
    jobs = [Job(Network(kind, UNITS), recipe, seed) for kind in ("mlp", "lstm") for seed in seeds]
    done, training = dict.fromkeys(jobs, 0), f"{name}, training"

    def passed(job: Job, epoch: int) -> None:
        done[job] = epoch
        report(training, sum(done.values()), len(jobs) * recipe.epochs)

    fitted = train_all(jobs, samples, settings.networks, passed)
    own = {f"{job.network.kind}, seed {job.seed}": _answer(job, fitted[job].theta) for job in jobs}
    return Case(name, rig, samples, {**{n: network.output for n, network in author.items()}, **own}, len(author))


def _answer(job: Job, theta: Singles) -> Answer:
    return lambda feature: job.network.predict(theta, feature.astype(np.float32))


def _teller(report: Report, what: str) -> Callable[[int, int], None]:
    return lambda done, total: report(what, done, total)
