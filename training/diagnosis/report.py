"""HTML report of a diagnosis: one file without scripts, the answer first and the details folded."""

from __future__ import annotations

import re
import shlex
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from noise.discrepancy.judge.verdict import TOLERANCE
from noise.discrepancy.moments.sample import logged_names
from noise.discrepancy.report import markup, words
from noise.discrepancy.report.numbers import bounds, estimate, parameter, plain, quantity, readable, with_interval
from noise.discrepancy.result import LEVEL, Cause, Diagnosis, HeldOut, Kind, Location, PValue, Verdict, Visible
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from training.diagnosis.figures import all_figures
from training.diagnosis.prediction import Prediction, along, axis, mismatches, predictor, thinned

TEMPLATES = Path(__file__).parent / "templates"
COLOURS = {
    Kind.NONE: "good",
    Kind.EXPLAINED: "found",
    Kind.PARTLY_EXPLAINED: "partly",
    Kind.UNEXPLAINED: "open",
    Kind.TOO_LITTLE_DATA: "partly",
}
N_WORST = 10
MAX_COLUMNS = 3  # logged columns in the table of the worst pings


def render(diagnosis: Diagnosis, corrected: str, seed: int = 0) -> str:
    """Return the page as HTML.

    Args:
        diagnosis: diagnosis to report.
        corrected: folder of the corrected model, for the instructions.
        seed: seed of randomised PIT values.
    """
    parent = Path(corrected).parent
    saved = any((parent / name / "model.json").is_file() for name in ("corrected", "difference"))
    named = {"corrected": corrected, "folder": shlex.quote(str(parent)), "unsaved": "" if saved else str(parent)}
    return re.sub(r"\n\s*\n+", "\n", fill("report.html", diagnosis, seed, **named))


def fill(template: str, diagnosis: Diagnosis, seed: int = 0, **variables: Any) -> str:
    """Return a template filled with the facts and figures of a diagnosis, and with further variables."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=select_autoescape(), undefined=StrictUndefined, trim_blocks=True
    )
    drawn = {name: Markup(text) for name, text in all_figures(diagnosis, seed).items()}
    figures = defaultdict(Markup, drawn)  # a figure that the recording cannot fill is empty
    return environment.get_template(template).render(**facts(diagnosis), figures=figures, **variables)


def facts(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the variables of the page's template."""
    verdict, batch = diagnosis.verdict, diagnosis.recorded
    silent, alike = words.silent(diagnosis), verdict.verdict in (Kind.NONE, Kind.TOO_LITTLE_DATA)
    answers = not alike and not silent
    return {
        "headline": words.headline(diagnosis),
        "badge": "No echo at all" if silent else words.BADGES[verdict.verdict],
        "kind": "open" if silent else COLOURS[verdict.verdict],
        "verdict": verdict,
        "warnings": verdict.warnings,
        "recording": Path(diagnosis.recording).name,
        "pings": len(batch),
        "visits": f"{batch.n_visits:,} visit{'' if batch.n_visits == 1 else 's'}",
        "moving": not batch.stationary.any(),
        "unanswered": diagnosis.unanswered,
        "silent": silent,
        "found": answers,
        "offered": diagnosis.corrected is not None,
        "acts": diagnosis.difference is not None,
        "left_out": [(words.name(name), reason) for name, reason in diagnosis.left_out.items()],
        "bar": Markup(markup.share_bar(verdict) + markup.legend(verdict)) if answers else "",
        "believed": any(cause.believed for cause in verdict.causes),
        "causes": [] if silent else [cause_facts(cause) for cause in verdict.causes],
        "where": [trifle(found) for found in verdict.unexplained.where] if alike else list(map(located, verdict.where)),
        "caption": "Along the condition where they differ" if _is_drawn(verdict, batch) else "Along the conditions",
        "rest": [located(found) for found in verdict.unexplained.where],
        "rest_share": with_interval(verdict.unexplained.share),
        "fit": fit_rows(verdict.held_out, diagnosis.corrected is not None),
        "tiles": tiles(diagnosis),
        "visible": [visible_row(each) for each in verdict.could_have_seen],
        "worst": {} if silent else worst_pings(diagnosis),
        "level": f"{100 * LEVEL:.0f} %",
        "p_value": p_text(verdict.p_value),
        "p_rest": p_text(verdict.unexplained.p_value),
        "catalogue": len(CATALOGUE),
        "listed": lambda effects: words.either(effects, "and"),
    }


def _is_drawn(verdict: Verdict, batch: Batch) -> bool:
    """Return whether the first mismatch is drawn along a condition that its region restricts."""
    found = next(iter(mismatches(verdict)), None)
    return found is not None and along(found, thinned(batch)) in found.region


def p_text(p_value: PValue) -> str:
    """Return a p-value as text: "p < 0.0005" where the bootstrap ends."""
    text = str(p_value)
    return f"p {text}" if text.startswith("<") else f"p = {text}"


def located(found: Location) -> dict[str, str]:
    """Return a located mismatch as template variables."""
    return {"text": words.location(found), "p": p_text(found.p_value)}


def trifle(found: Location) -> dict[str, str]:
    """Return a located mismatch that is too small to matter as template variables, with the tolerance."""
    limit = words.least(Visible(found.aspect, TOLERANCE.get(found.aspect, 0.0), found.aspect.unit))
    told = located(found)
    return {**told, "text": f"{told['text']}: two recordings of one sonar may differ by {limit}"}


def cause_facts(cause: Cause) -> dict[str, Any]:
    """Return the template variables of one cause."""
    rivals = [(words.name(each.effect), each.probability) for each in cause.alternatives]
    return {
        "title": capital(words.name(cause.effect)),
        "effect": cause.effect,
        "statement": words.statement(cause) + ".",
        "share": estimate(cause.share),
        "share_bounds": bounds(cause.share),
        "candidates": [
            (text, quantity(weight, "1"), f"{100 * weight:.1f}")
            for text, weight in [(words.name(cause.effect), cause.probability), *rivals]
        ],
        "ambiguous": bool(rivals),
        "gain": f"{plain(cause.gain_nats, 3)} ± {plain(cause.gain_se)}",
        "parameters": [(readable(name, each.unit), parameter(name, each)) for name, each in cause.parameters.items()],
    }


def capital(text: str) -> str:
    """Return a text with its first letter in upper case."""
    return text[:1].upper() + text[1:]


def tiles(diagnosis: Diagnosis) -> list[tuple[str, str, str]]:
    """Return the three numbers at the top of the page: title, value and explanation."""
    verdict, test = diagnosis.verdict, diagnosis.verdict.held_out
    if words.silent(diagnosis):
        return [("Pings with an echo", "0", f"of {len(diagnosis.recorded):,}")]
    before = quantity(test.before.crps_m, "m")
    if verdict.verdict in (Kind.NONE, Kind.TOO_LITTLE_DATA):
        return [
            ("Mean prediction error", before, f"of your simulation, on {test.n_pings:,} unseen pings"),
            (
                "Predicted from its own nearest positions",
                quantity(test.repeatability_m, "m"),
                "by the recording itself",
            ),
            ("Pings", f"{len(diagnosis.recorded):,}", "in the recording"),
        ]
    after = f" → {quantity(test.after.crps_m, 'm')}" if diagnosis.corrected is not None else ""
    note = "simulation → corrected model" if after else "no correction beats your simulation"
    rest = verdict.unexplained.share.value
    shown = (
        ("Explained", max(0.0, 1.0 - rest)) if any(each.believed for each in verdict.causes) else ("Unexplained", rest)
    )
    return [
        ("Mean prediction error", before + after, f"{note}, on {test.n_pings:,} unseen pings"),
        (shown[0], quantity(shown[1], "1"), "of the difference"),
        (
            "Predicted from its own nearest positions",
            quantity(test.repeatability_m, "m"),
            "by the recording itself",
        ),
    ]


def fit_rows(test: HeldOut, offered: bool) -> list[tuple[str, str, str]]:
    """Return name, mean error and log-likelihood per ping of every model on unseen visits."""
    rows = [("your simulation", test.before)]
    rows += [("emulator of your simulation", test.emulator)] if test.emulator != test.before else []
    rows += [("corrected model", test.after)] if offered else []
    table = [(name, quantity(each.crps_m, "m"), plain(each.log_likelihood_per_ping, 3)) for name, each in rows]
    return [*table, ("the recording's own nearest positions", quantity(test.repeatability_m, "m"), "")]


def visible_row(each: Visible) -> tuple[str, str]:
    """Return effect or aspect and the least size that would have shown."""
    return words.visible_name(each), words.least(each)


def worst_pings(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the pings that the user's simulation predicts worst, as header and rows of a table."""
    whole, model = diagnosis.recorded, predictor(diagnosis)
    # many models give errors of any size the probability 0, so that ties are ordered by the error
    certainty = np.maximum(model.law(whole.ping, whole.past).log_prob(whole.reading), -100.0)
    batch = whole.select(np.isin(np.arange(len(whole)), np.lexsort((-np.abs(whole.error), certainty))[:N_WORST]))
    before = Prediction.of(model, batch)
    after = None if diagnosis.corrected is None else Prediction.of(diagnosis.corrected, batch)
    names = logged_names(batch.ping)[:MAX_COLUMNS]
    header = [
        "time (s)",
        "distance (mm)",
        "angle (°)",
        *(axis(name, batch)[0] for name in names),
        "reading (mm)",
        "simulation expects (mm)",
    ]
    header += [] if after is None else ["corrected model expects (mm)"]
    return {"header": header, "rows": [_row(batch, k, names, before, after) for k in range(len(batch))]}


def _row(batch: Batch, k: int, names: list[str], before: Prediction, after: Prediction | None) -> list[str]:
    ping, echo = batch.ping, bool(batch.reading.echo[k])
    expected = [before] if after is None else [before, after]
    return [
        f"{ping.time[k]:.1f}",
        f"{1000 * ping.distance[k]:.0f}",
        f"{np.degrees(ping.angle[k]):.1f}",
        *(_four_digits(axis(name, batch)[1] * ping.covariates[name][k]) for name in names),
        f"{1000 * batch.reading.range[k]:.0f}" if echo else "no echo",
        *(f"{1000 * each.median[k]:.0f}" if each.law.echo[k] > 0.5 else "no echo" for each in expected),
    ]


def _four_digits(value: float) -> str:
    """Return a number with four significant digits, without an exponent.

    >>> _four_digits(20_000.3), _four_digits(0.012345)
    ('20000', '0.01235')
    """
    return np.format_float_positional(value, precision=4, unique=False, fractional=False, trim="-")
