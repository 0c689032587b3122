"""Write the report on noise models: scores of all models, gain of memory, calibration of credence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from string import Template
from typing import Annotated, TypedDict

import numpy as np
from annotated_types import MinLen
from numpy.typing import NDArray

from acquisition import Recording, SettingError
from acquisition.io.files import write_bytes, write_text
from acquisition.io.places import OutputFolder
from acquisition.limits import Count
from noise import CredenceTable, SonarModel, follow, load_model
from noise.learned.networks import MlpModel
from noise.learned.recent import RecentCredence
from noise.metrics import Reliability, credence_reliability, is_correct
from noise.store import ModelName
from training.common.canvas import AFTER, BEFORE, SOFT, Axes, panels
from training.common.commit import commit
from training.common.progress import bar
from training.common.records import write_record
from training.common.tables import markdown_table
from training.noise.compare import baselines, compare, comparison_text, sensor_conditions
from training.noise.corpus import RECORDINGS, ensure_recorded
from training.noise.experiments import (
    SCENARIOS,
    CredenceScore,
    MemoryExperiment,
    RecentCredencePlan,
    learn_credence,
    measure,
)
from training.noise.findings import (
    ALONE,
    BAYES,
    POSITIONS,
    RECENT,
    TEST_SETS,
    ConditionCredence,
    NoiseFindings,
    by_position_in_condition,
    targets,
)

PAGE = Path(__file__).parent / "templates" / "noise_models.md"
SHIPPED = ("srf08-mlp", "srf08-lstm", "srf08-hybrid")
EDGES = np.linspace(0.0, 6.6, 301)  # m; bins of the table of credence given one reading
PRIOR_CONDITIONS = 20_000  # number of conditions in the prior of Bayes' rule
DEPTHS = {ALONE: 1, RECENT: 8}
STEPS = 4  # of the report besides recordings and scenarios
MIN_BIN_PINGS = 20  # of a bin in the reliability diagrams


class Curve(TypedDict):
    """Predicted credence, observed frequency and its error in each bin, (3, bins), and the mean gap between them."""

    points: list[list[float]]
    gap: float


Diagrams = dict[str, dict[str, Curve]]


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym noise-report`."""

    data: OutputFolder = Path("corpus")
    """Folder of the recordings; missing ones are recorded."""
    out: OutputFolder = Path("docs/explanation")
    """Folder to write noise-models.md and images/noise-credence.png, with its record, to."""
    models: Annotated[tuple[ModelName, ...], MinLen(1)] = SHIPPED
    """Models to compare with the baselines, by name or folder; a perceptron first."""
    sessions: Count = 40
    """Number of sessions per scenario in which the gain of memory is measured."""


def main(args: Args) -> None:
    """Run all comparisons and write the report.

    Raises:
        SettingError: the first model is not a perceptron.
    """
    made_by = commit()
    models = {name.split("/")[-1]: load_model(name) for name in args.models}
    total = len(RECORDINGS) + len(SCENARIOS) + STEPS
    with bar("scoring", total) as progress:
        step = iter(range(1, total + 1))
        tick = lambda: progress(next(step), total)  # noqa: E731
        recordings = {}
        for name in RECORDINGS:
            recordings[name] = Recording.load(ensure_recorded(args.data, name))
            tick()
        found = collect(models, recordings, MemoryExperiment(sessions=args.sessions), tick)
    picture = args.out / "images" / "noise-credence.png"
    diagrams = diagrams_of(models, recordings, found.given)
    write_bytes(picture, figure(write_record(picture, made_by, "sonar-gym noise-report", diagrams)))
    write_text(args.out / "noise-models.md", page(found, made_by))
    print(f"{args.out / 'noise-models.md'}: written")


def collect(
    models: Mapping[str, SonarModel],
    recordings: Mapping[str, Recording],
    experiment: MemoryExperiment,
    tick: Callable[[], None],
) -> NoiseFindings:
    """Return all results of the report."""
    first = next(iter(models.values()))
    if not isinstance(first, MlpModel):
        raise SettingError("noise-report: the first of --models must be a perceptron, whose law Bayes' rule uses")
    rivals = baselines(recordings["known"])
    comparisons, gains = {}, {}
    for name in TEST_SETS:
        comparisons[name] = compare(recordings[name], {**rivals, **models})
        tick()
    for scenario in SCENARIOS:
        gains[scenario] = measure(SCENARIOS[scenario], experiment)
        tick()
    given_condition = {
        name: {model: ConditionCredence.of(models[model], recordings[name]) for model in models} for name in TEST_SETS
    }
    tick()
    by_position = {name: by_position_in_condition(model, recordings["sensors"]) for name, model in models.items()}
    by_bayes, learned = credences(first, recordings)
    given = {name: score_credences(by_bayes, learned, recordings[f"fresh-{name}"]) for name in TEST_SETS}
    tick()
    return NoiseFindings(comparisons, given_condition, given, gains, by_position, tuple(models))


def credences(
    model: SonarModel, recordings: Mapping[str, Recording]
) -> tuple[CredenceTable, dict[str, RecentCredence]]:
    """Return credence given one reading by Bayes' rule, and networks for one and for several readings."""
    train, validation = recordings["train"], recordings["validation"]
    rows = np.random.default_rng(0).permutation(len(train))[:PRIOR_CONDITIONS]
    learned = {label: learn_credence(train, validation, RecentCredencePlan(depth)) for label, depth in DEPTHS.items()}
    return CredenceTable.over(model, train.ping[rows], EDGES), learned


def score_credences(
    by_bayes: CredenceTable, learned: Mapping[str, RecentCredence], test: Recording
) -> dict[str, CredenceScore]:
    """Return the scores of credence given the readings, on new sessions."""
    ping, reading = test.ping, test.reading
    echo, visit = reading.echo, np.unique(np.stack([test.run, test.condition]), axis=1, return_inverse=True)[1].ravel()
    values = {BAYES: by_bayes.given(reading), **{label: one.follow(ping, reading) for label, one in learned.items()}}
    correct = is_correct(ping, reading)
    return {label: CredenceScore.of(value[echo], correct[echo], visit[echo]) for label, value in values.items()}


def page(found: NoiseFindings, made_by: str) -> str:
    """Return the page in Markdown, with the commit that made it."""
    gains = [(name, gain.without, gain.gain) for name, gain in found.gains.items()]
    by_position = [(name, *scores.values()) for name, scores in found.by_position.items()]
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        commit=made_by,
        targets=markdown_table(("target", "result", "met"), [target.row for target in targets(found)]),
        condition=_condition_table(found),
        gains=markdown_table(("scenario", "without memory", "gain of memory"), gains),
        by_position=markdown_table(("model", *POSITIONS), by_position),
        given=_readings_table(found),
        **{name: comparison_text(one) for name, one in found.comparisons.items()},
    )


def _condition_table(found: NoiseFindings) -> str:
    header = ("test set", "model", "gap", "mean error", "coverage")
    rows = [
        (TEST_SETS[name], model, f"{one.gap:.3f}", f"{one.error:.3f}", f"{100 * one.coverage:.0f} %")
        for name, models in found.condition_credence.items()
        for model, one in models.items()
    ]
    return markdown_table(header, rows)


def _readings_table(found: NoiseFindings) -> str:
    header = ("test set", "credence", "log score, nats", "Brier score", "gap")
    rows = [
        (TEST_SETS[name], label, one.log_score, one.brier, f"{one.reliability.gap:.3f}")
        for name, scores in found.given.items()
        for label, one in scores.items()
    ]
    return markdown_table(header, rows)


def diagrams_of(
    models: Mapping[str, SonarModel],
    recordings: Mapping[str, Recording],
    given: Mapping[str, Mapping[str, CredenceScore]],
) -> Diagrams:
    """Return the curves of both kinds of credence on both test sets, by title of the diagram and label."""
    found: Diagrams = {}
    for name, label in TEST_SETS.items():
        test = recordings[name]
        laws = {model: follow(models[model], test.ping, test.reading) for model in models}
        found[f"given the condition: {label}"] = {
            model: _curve(credence_reliability(law, test.reading, sensor_conditions(test)))
            for model, law in laws.items()
        }
    for name, scores in given.items():
        curves = {method: _curve(score.reliability) for method, score in scores.items()}
        found[f"given the readings: {TEST_SETS[name]}"] = curves
    return found


def _curve(found: Reliability) -> Curve:
    rows: NDArray[np.bool_] = found.pings >= MIN_BIN_PINGS
    points = np.stack([found.predicted[rows], found.observed[rows], found.error[rows]])
    return {"points": points.tolist(), "gap": found.gap}


def figure(diagrams: Diagrams) -> bytes:
    """Return reliability diagrams as PNG."""
    draws = [partial(_diagram, title=title, curves=curves) for title, curves in diagrams.items()]
    return panels(draws, (9.0, 8.4), columns=2)


def _diagram(ax: Axes, title: str, curves: Mapping[str, Curve]) -> None:
    ax.plot([0, 1], [0, 1], color=SOFT, lw=1)
    for (label, curve), colour, mark in zip(curves.items(), (BEFORE, SOFT, AFTER), "s^o", strict=True):
        text = f"{label.removesuffix(' over the training conditions')}\n(gap {curve['gap']:.3f})"
        predicted, observed, error = curve["points"]
        ax.errorbar(predicted, observed, error, color=colour, marker=mark, ms=4, label=text)
    ax.set(xlabel="predicted credence", ylabel="observed frequency", xlim=(0, 1), ylim=(0, 1))
    ax.set_title(title.replace(": ", ":\n"))
    ax.legend(loc="lower right", fontsize=9)
