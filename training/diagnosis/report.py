"""HTML report of a diagnosis: differences, causes, rivals, next measurements."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from noise.discrepancy import Diagnosis
from noise.discrepancy.judge.rest import in_words
from noise.discrepancy.judge.verdict import Named, Verdict
from noise.discrepancy.name.explanation import Interval
from noise.effects import CATALOGUE
from training.diagnosis.figures import all_figures

TEMPLATES = Path(__file__).parent / "templates"
BADGES = {
    "none": ("No difference found", "good"),
    "named": ("Cause found", "found"),
    "confounded": ("Cause narrowed down", "found"),
    "named_with_rest": ("Cause found, part unexplained", "partly"),
    "unknown": ("Difference without a known cause", "open"),
}


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict as one or two sentences."""
    verdict = diagnosis.verdict
    if silent(diagnosis):
        first = "check the sensor's power, gain, range setting and direction"
        return f"None of {diagnosis.pings:,} pings had an echo: {first}."
    if verdict.verdict == "none":
        return f"The model agrees with the recording: its CRPS is {verdict.held_out.before.crps_mm:.1f} mm."
    if verdict.verdict == "unknown":
        what = verdict.unknown.description or "; ".join(in_words(f) for f in verdict.where[:1])
        what = what.split(";")[0].replace(" (a description, not a cause)", "")
        return f"The recording differs from the model, and no known effect explains it: {what}."
    statements = " ".join(named.statement for named in verdict.effects[:2])
    rivals = sorted({name for named in verdict.effects for name in named.indistinguishable_from})
    others = len(verdict.effects) - 2
    more = "" if others < 1 else f" And {others} smaller effect{'s' if others > 1 else ''}."
    doubt = f" These data do not distinguish this from {_list(rivals)}." if verdict.verdict == "confounded" else ""
    rest = " A smaller difference remains unexplained." if verdict.verdict == "named_with_rest" else ""
    return statements + more + doubt + rest


def silent(diagnosis: Diagnosis) -> bool:
    """Return whether no ping of the recording had an echo."""
    return not diagnosis.split.whole.reading.echo.any()


def _list(names: list[str]) -> str:
    words = [plain(name) for name in names]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def plain(name: str) -> str:
    """Return an effect's id as words."""
    return name.replace("_", " ")


def render(diagnosis: Diagnosis, corrected: str, seed: int = 0) -> str:
    """Return the page as HTML.

    Args:
        diagnosis: diagnosis to report.
        corrected: folder of the corrected model, for the instructions.
        seed: seed of randomised PIT values.
    """
    return re.sub(r"\n\s*\n+", "\n", fill("report.html", diagnosis, seed, corrected=corrected))


def fill(template: str, diagnosis: Diagnosis, seed: int = 0, **variables: Any) -> str:
    """Return a template filled with the facts and figures of a diagnosis, and with further variables."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=select_autoescape(), undefined=StrictUndefined, trim_blocks=True
    )
    figures = {name: Markup(text) for name, text in all_figures(diagnosis, seed).items()}
    return environment.get_template(template).render(**facts(diagnosis), figures=figures, **variables)


def facts(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the variables of the page's template."""
    verdict = diagnosis.verdict
    badge, kind = BADGES[verdict.verdict]
    return {
        "headline": headline(diagnosis),
        "badge": badge,
        "kind": kind,
        "verdict": verdict,
        "recording": Path(diagnosis.recording).name,
        "pings": diagnosis.pings,
        "unanswered": diagnosis.unanswered,
        "certainty": certainty(by_chance(verdict)),
        "effects": [effect_facts(named) for named in verdict.effects],
        "where": [in_words(finding) for finding in verdict.where],
        "rivals": rival_rows(diagnosis),
        "tried": tried_rows(diagnosis),
        "catalogue": len(CATALOGUE),
        "silent": silent(diagnosis),
        "matched": matched(diagnosis),
    }


def matched(diagnosis: Diagnosis) -> str:
    """Return a sentence on the positions that both files share, compared without a model; empty if too few."""
    found = diagnosis.verdict.matched
    if found is None:
        return ""
    differ = (
        f"differ, by {1000 * found.shift_m:+.1f} mm in the median" if found.differs else "do not differ beyond chance"
    )
    return f"Compared directly, without any model, the {found.cells} positions that both files share {differ}."


def by_chance(verdict: Verdict) -> float:
    """Return the p-value of the difference, that of unexplained structure included."""
    return min(verdict.p_value, verdict.unknown.p_value) if verdict.unknown.present else verdict.p_value


def certainty(p_value: float) -> str:
    """Return a p-value as a sentence."""
    if p_value > 0.05:
        return "The difference is not significant."
    return f"Chance alone causes such a difference in fewer than one recording in {int(1 / max(p_value, 1e-6)):,}."


def effect_facts(named: Named) -> dict[str, Any]:
    """Return the template variables of one named effect."""
    return {
        **asdict(named),
        "title": plain(named.effect),
        "summary": CATALOGUE[named.effect].summary,
        "rivals": [plain(name) for name in named.indistinguishable_from],
        "percent": f"{100 * named.probability:.0f}",
        "numbers": [(parameter(name, value.unit), interval(value)) for name, value in named.parameters.items()],
        "gain": f"{named.gain_nats:.0f} ± {named.gain_se:.0f}",
    }


def parameter(name: str, unit: str) -> str:
    """Return a parameter's name as words, without the unit at its end."""
    return plain(name.removesuffix("_" + unit.lower().replace("/", "_per_").replace("degc", "c")))


def interval(value: Interval) -> str:
    """Return a value with its 90 % interval and unit."""
    unit = "" if value.unit == "1" else f" {value.unit.replace('degC', '°C')}"
    if value.unit == "m" and max(abs(value.low), abs(value.high)) < 1.0:
        return f"{1000 * value.value:.3g} mm ({1000 * value.low:.3g} to {1000 * value.high:.3g})"
    return f"{value.value:.3g}{unit} ({value.low:.3g} to {value.high:.3g})"


def rival_rows(diagnosis: Diagnosis) -> list[dict[str, str]]:
    """Return one row for each effect that was fitted instead of a named one."""
    rows = []
    for rival in diagnosis.rivals:
        reason = "not excluded" if rival.survives else f"fits worse by {rival.observed:.0f} nats"
        if not rival.survives and rival.observed > 10.8:
            reason += ": excluded"
        rows.append({"rival": plain(rival.effect), "instead": plain(rival.replaces), "why": reason})
    return rows


def tried_rows(diagnosis: Diagnosis) -> list[dict[str, str]]:
    """Return one row for each effect that was fitted in the search and scored by cross-validation."""
    rows = []
    for attempt in diagnosis.verdict.attempts:
        if attempt.gain_nats == attempt.gain_nats:
            given = ", ".join(plain(name) for name in attempt.given) or "nothing"
            gain = f"{attempt.gain_nats:+.1f} ± {attempt.gain_se:.1f}"
            rows.append({"effect": plain(attempt.effect), "given": given, "gain": gain, "decision": attempt.decision})
    return rows
