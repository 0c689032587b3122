"""Write the page on noise models: all side by side, what memory is worth, how far credence can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray

from acquisition import Recording, SettingError
from acquisition.io.files import write_bytes, write_text
from noise import CredenceTable, SonarModel, follow, load_model
from noise.law import Floats
from noise.learned.networks import MlpModel
from noise.learned.recent import RecentCredence
from noise.metrics import Reliability, credence_reliability
from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, panels
from training.common.commit import commit
from training.common.progress import bar
from training.noise.compare import HEADINGS, Compared, baselines, compare, place, rows
from training.noise.corpus import RECORDINGS, written
from training.noise.draw_paths import PATHS
from training.noise.draw_speed import of_credence, of_models, of_paths
from training.noise.draw_speed import rows as speed_rows
from training.noise.findings import ALONE, BAYES, RECENT, WHERE, Findings, Told, aims, by_nth
from training.noise.memory_gain import WORLDS, Plan, measure
from training.noise.recent_credence import CredenceScore, learn_credence, right
from training.noise.recent_credence import Plan as CredencePlan

PAGE = Path(__file__).parent / "templates" / "noise_models.md"
SHIPPED = ("srf08-mlp", "srf08-lstm", "srf08-hybrid")
EDGES = np.linspace(0.0, 6.6, 301)  # m; bins of the table of credence given one reading
PRIOR_PINGS = 20_000  # conditions over which Bayes' rule is taken
DEPTHS = {ALONE: 1, RECENT: 8}
STEPS = 7  # of the report besides recordings and worlds


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym noise-report`."""

    data: Path = Path("corpus")
    """Folder for the recordings; those that are there already are not made again."""
    docs: Path = Path("docs")
    """Folder to write noise-models.md and images/noise-credence.png to."""
    models: tuple[str, ...] = SHIPPED
    """Models to compare with the baselines, by name or folder; a perceptron first."""
    sessions: int = 40
    """Sessions of each world in which the worth of memory is measured."""


def main(args: Args) -> None:
    """Find everything out and write the page.

    Raises:
        SettingError: the first model is no perceptron.
    """
    made_by = commit()
    models = {name.split("/")[-1]: load_model(name) for name in args.models}
    total = len(RECORDINGS) + len(WORLDS) + STEPS
    with bar("scoring", total) as progress:
        step = iter(range(1, total + 1))
        tick = lambda: progress(next(step), total)  # noqa: E731
        recordings = {}
        for name in RECORDINGS:
            recordings[name] = Recording.load(written(args.data, name))
            tick()
        found = find(models, recordings, Plan(sessions=args.sessions), tick)
    write_bytes(args.docs / "images" / "noise-credence.png", figure(models, recordings, found.given))
    write_text(args.docs / "noise-models.md", page(found, made_by))
    print(f"{args.docs / 'noise-models.md'}: written")


def find(
    models: Mapping[str, SonarModel], recordings: Mapping[str, Recording], plan: Plan, tick: Callable[[], None]
) -> Findings:
    """Find out all that the page tells."""
    first = next(iter(models.values()))
    if not isinstance(first, MlpModel):
        raise SettingError("noise-report: the first of --models must be a perceptron, which drawing is timed with")
    rivals = baselines(recordings["known"])
    compared, gains = {}, {}
    for where in WHERE:
        compared[where] = compare(recordings[where], {**rivals, **models})
        tick()
    for name, world in WORLDS.items():
        gains[name] = measure(world, plan)
        tick()
    told = {where: {name: Told.by(model, recordings[where]) for name, model in models.items()} for where in WHERE}
    tick()
    heard = {name: by_nth(model, recordings["units"]) for name, model in models.items()}
    by_bayes, learned = credences(first, recordings)
    given = {where: trust(by_bayes, learned, recordings[f"fresh-{where}"]) for where in WHERE}
    tick()
    speeds = of_models(models) | of_credence(by_bayes, learned[RECENT])
    tick()
    paths = of_paths(first, PATHS)
    tick()
    return Findings(compared, told, given, gains, heard, speeds, paths, tuple(models))


def credences(
    model: SonarModel, recordings: Mapping[str, Recording]
) -> tuple[CredenceTable, dict[str, RecentCredence]]:
    """Return credence given one reading, by Bayes, and what is learned of one and of the last few."""
    train, choose = recordings["train"], recordings["validation"]
    some = np.random.default_rng(0).permutation(len(train))[:PRIOR_PINGS]
    learned = {label: learn_credence(train, choose, CredencePlan(depth)) for label, depth in DEPTHS.items()}
    return CredenceTable.over(model, train.ping[some], EDGES), learned


def trust(by_bayes: CredenceTable, learned: Mapping[str, RecentCredence], test: Recording) -> dict[str, CredenceScore]:
    """Return how good credence given the readings is, on fresh sessions."""
    ping, reading = test.ping, test.reading
    echo, visit = reading.echo, np.unique(np.stack([test.run, test.condition]), axis=1, return_inverse=True)[1].ravel()
    said: dict[str, Floats] = {BAYES: by_bayes.given(reading)}
    said |= {label: one.follow(ping, reading) for label, one in learned.items()}
    true = right(ping, reading)
    return {label: CredenceScore.of(value[echo], true[echo], visit[echo]) for label, value in said.items()}


def page(found: Findings, made_by: str) -> str:
    """Return the page in Markdown, with the commit that made it."""
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        commit=made_by,
        aims="\n".join(aim.row for aim in aims(found)),
        condition="\n".join(_condition_rows(found)),
        gains="\n".join(f"| {name} | {g.without} | {g.gain} |" for name, g in found.gains.items()),
        heard="\n".join(f"| {name} | {' | '.join(map(str, one.values()))} |" for name, one in found.heard.items()),
        given="\n".join(_given_rows(found)),
        speeds=speed_rows(found.speeds),
        paths=speed_rows(found.paths),
        **{where: _table(one) for where, one in found.compared.items()},
    )


def _table(compared: Compared) -> str:
    score = compared.repeatability
    head = f"{score.pings} fresh pings in {score.clusters} conditions, standard errors over these."
    lines = [f"| {' | '.join(row)} |" for row in (HEADINGS, ("---",) * len(HEADINGS), *rows(compared))]
    return "\n".join([head, "", *lines])


def _condition_rows(found: Findings) -> list[str]:
    return [
        f"| {WHERE[where]} | {name} | {one.gap:.3f} | {one.off:.3f} | {100 * one.inside:.0f} % |"
        for where, told in found.told.items()
        for name, one in told.items()
    ]


def _given_rows(found: Findings) -> list[str]:
    return [
        f"| {WHERE[where]} | {label} | {s.log_score} | {s.brier} | {s.reliability.gap:.3f} |"
        for where, scores in found.given.items()
        for label, s in scores.items()
    ]


def figure(
    models: Mapping[str, SonarModel],
    recordings: Mapping[str, Recording],
    given: Mapping[str, Mapping[str, CredenceScore]],
) -> bytes:
    """Return reliability diagrams of both kinds of credence, on other conditions and on other sensors, as PNG."""
    draws = []
    for where in WHERE:
        test = recordings[where]
        curves = {
            n: credence_reliability(follow(m, test.ping, test.reading), test.reading, place(test))
            for n, m in models.items()
        }
        draws.append(partial(_diagram, title=f"given the condition: {WHERE[where]}", curves=curves))
    for where, scores in given.items():
        curves = {label: score.reliability for label, score in scores.items()}
        draws.append(partial(_diagram, title=f"given the readings: {WHERE[where]}", curves=curves))
    return panels(draws, (10.0, 9.0), columns=2)


def _diagram(ax: Axes, title: str, curves: Mapping[str, Reliability]) -> None:
    ax.plot([0, 1], [0, 1], color=SOFT, lw=1)
    for (label, curve), colour, mark in zip(curves.items(), (BEFORE, SOFT, AFTER), "s^o", strict=True):
        seen: NDArray[np.bool_] = curve.pings >= 20
        name = f"{label} (gap {curve.gap:.3f})"
        ax.errorbar(
            curve.said[seen], curve.came_true[seen], curve.error[seen], color=colour, marker=mark, ms=4, label=name
        )
    ax.set(title=title, xlabel="credence said", ylabel="came true", xlim=(0, 1), ylim=(0, 1))
    ax.legend(loc="upper left")
    ax.tick_params(colors=INK)
