"""Sentences for aspects, locations, causes and verdicts, in plain English."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from noise.discrepancy.report.numbers import bounds, estimate, place, plain, quantity, with_interval
from noise.discrepancy.result import (
    Aspect,
    Cause,
    Diagnosis,
    Interval,
    Kind,
    Location,
    Measurement,
    Unexplained,
    Verdict,
    Visible,
)
from noise.discrepancy.thresholds import FALSE_ALARM, LISTED, PARTLY_SHARE

# effects whose id is not already their plain name
NAMES = {
    "sound_speed": "speed of sound",
    "clock_scale": "clock",
    "dropped_reading": "lost readings",
    "stale_repeat": "repeated readings",
    "stuck": "stuck readings",
    "spike": "random readings",
    "noise_burst": "bursts of noise",
    "corrupted_byte": "transmission errors",
    "fixed_clutter": "an object at a fixed range",
    "background_reflector": "an object behind the target",
    "multipath": "reflections from the floor",
    "repeated_bounce": "a second round trip",
    "previous_ping": "echoes of the previous ping",
    "synchronous_crosstalk": "another sonar firing at the same time",
    "asynchronous_crosstalk": "another sonar with its own clock",
    "false_alarm": "false alarms",
    "rearm_dead_time": "a receiver that starts to listen late",
    "time_walk": "late detection of weak echoes",
    "travel_time_jitter": "scatter from ping to ping",
    "specular_loss": "loss at tilted smooth targets",
    "scintillation": "turbulence",
    "latency": "late time stamps or poses",
}
ASPECTS = {str(aspect): aspect.words for aspect in Aspect}
CHANGES = {  # names where an effect is a change of a known size
    "clock_scale": "clock error",
    "sound_speed": "change of air temperature",
    "sensitivity": "loss of sensitivity",
    "beam_width": "change of beam width (ka)",
    "quantisation": "coarser step of readings",
    "false_alarm": "rate of false alarms",
    "fixed_clutter": "share of echoes from an object at a fixed range",
}
NO_SHARE = ("beam_width",)  # dimensionless sizes that are no shares
BADGES = {
    Kind.NONE: "No difference that matters",
    Kind.EXPLAINED: "Difference explained",
    Kind.PARTLY_EXPLAINED: "Difference partly explained",
    Kind.UNEXPLAINED: "Difference without a known cause",
    Kind.TOO_LITTLE_DATA: "Too little data",
}
SENTENCES = {  # sentence, and its word for a positive and for a negative size
    Aspect.BIAS: ("Echoes read {size} {sign}", "long", "short"),
    Aspect.SPREAD: ("Echoes scatter {size} {sign}", "more", "less"),
    Aspect.SKEW: ("Errors have a longer tail towards {sign} readings", "long", "short"),
    Aspect.DETECTION: ("{size} {sign} of the pings have an echo", "more", "fewer"),
    Aspect.EARLY: ("{size} {sign} of the readings lie far before the target", "more", "fewer"),
    Aspect.LATE: ("{size} {sign} of the readings lie far behind the target", "more", "fewer"),
    Aspect.REPEAT: ("{size} {sign} of the readings repeat the one before", "more", "fewer"),
    Aspect.MEMORY: ("Each error is {sign} similar to the error before it", "more", "less"),
    Aspect.COINCIDENCE: ("Far readings of one position agree {sign} with each other", "more", "less"),
}
FIRST = ("zero_offset", "dropped_reading", "clock_scale", "spike")  # of what could have been seen, in a headline
MIN_RIVAL = 0.05  # probability from which an alternative is part of the headline; less is listed below it
SILENT = "No ping had an echo: check the sensor's power, gain, range setting and direction."


def name(effect: str) -> str:
    """Return the plain name of an effect."""
    return NAMES.get(effect, effect.replace("_", " "))


def either(effects: Sequence[str], last: str = "or") -> str:
    """Return effects as a list in words.

    >>> either(["sound_speed", "clock_scale", "thermal_drift"])
    'speed of sound, clock or thermal drift'
    """
    names = [name(effect) for effect in effects]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def location(found: Location) -> str:
    """Return a located mismatch as a sentence without a full stop."""
    sentence, more, less = SENTENCES[found.aspect]
    signed = _of_sd(found.size) if found.aspect is Aspect.SPREAD else found.size
    low, high = sorted((abs(signed.low), abs(signed.high)))
    size = replace(signed, value=abs(signed.value), low=low, high=high)
    doubtful = signed.low * signed.high <= 0
    value = quantity(size.value, size.unit) if doubtful else estimate(size)
    shown = sentence.format(size=value, sign=less if signed.value < 0 else more)
    between = "" if doubtful or "{size}" not in sentence else f" ({bounds(size)})"
    return f"{shown}{between} {place(found.region)}"


def _of_sd(found: Interval) -> Interval:
    """Return the relative change of a standard deviation; sizes of spread are half that of the variance."""
    half = np.array([found.value, found.low, found.high])
    value, low, high = np.sqrt(np.maximum(1.0 + 2.0 * half, 0.0)) - 1.0
    return Interval(float(value), float(low), float(high), found.unit)


def statement(cause: Cause) -> str:
    """Return the statement of a cause with printed units and without its full stop."""
    return cause.statement.replace("degC", "°C").rstrip(". ")


def symptom(cause: Cause) -> str:
    """Return what a cause does to readings, with a number; relative errors also in mm at 1 m."""
    clause = statement(cause).split(":")[0]
    clause = clause if any(letter.isdigit() for letter in clause) else statement(cause)
    return re.sub(
        r"([\d.]+) % of distance", lambda found: f"{found[1]} % ({plain(10 * float(found[1]))} mm at 1 m)", clause
    )


def ambiguous(cause: Cause) -> str:
    """Return a cause as a headline; a question if the data do not exclude alternatives."""
    effects = _not_excluded(cause)
    return statement(cause) if len(effects) == 1 else f"{symptom(cause)}: {either(effects)}?"


def _not_excluded(cause: Cause) -> list[str]:
    return [cause.effect, *(each.effect for each in cause.alternatives if each.probability >= MIN_RIVAL)]


def explains(cause: Cause) -> str:
    """Return share and probability of a cause as a phrase."""
    share = f"explains {estimate(cause.share)} of the difference ({bounds(cause.share)})"
    others = ", ".join(f"{name(each.effect)} {quantity(each.probability, '1')}" for each in cause.alternatives)
    rival = f"; or {others}" if others else ""
    return f"{name(cause.effect)}: {share}; probability {quantity(cause.probability, '1')}{rival}"


def visible(each: Visible) -> str:
    """Return the least size that would have shown, as a phrase."""
    size, what = least(each), visible_name(each)
    if each.unit == "1" and what.endswith(" readings"):
        return f"{size} {what}"
    return f"a {what} {'by' if what.startswith('change') else 'of'} {size}"


def least(each: Visible) -> str:
    """Return the least size that would have shown, with its unit."""
    size = each.least
    if each.effect == Aspect.SPREAD:
        size = _of_sd(Interval(size, size, size, each.unit)).value
    return quantity(size, each.unit, percent=each.effect not in NO_SHARE)


def visible_name(each: Visible) -> str:
    """Return an effect or an aspect as words."""
    if each.effect in ASPECTS:
        return ASPECTS[each.effect]
    return CHANGES.get(each.effect, name(each.effect))


def summary_of(
    kind: Kind,
    causes: Sequence[Cause],
    where: Sequence[Location],
    unexplained: Unexplained,
    could_have_seen: Sequence[Visible],
    n_pings: int,
) -> str:
    """Return a verdict as one plain sentence with a number and a unit.

    Args:
        kind: verdict in one word.
        causes: selected causes, the believed ones and the greatest shares first.
        where: located mismatches, the most certain first.
        unexplained: the rest; without causes all of it.
        could_have_seen: least visible sizes.
        n_pings: number of answered pings.
    """
    if kind is Kind.NONE:
        trifle = unexplained.p_value.value < FALSE_ALARM
        found = "A difference too small to matter" if trifle else "No difference found"
        return f"{found} in {_pings(n_pings)}{_would_show(could_have_seen)}."
    if kind is Kind.TOO_LITTLE_DATA:
        return f"Too little data: {_pings(n_pings)} cannot decide{_needs(could_have_seen)}."
    believed = [cause for cause in causes if cause.believed]
    if kind is Kind.UNEXPLAINED or not believed:
        found = location((*where, *unexplained.where)[0]) if where or unexplained.where else "The readings differ"
        return f"{found}: {_possible(causes)}."
    told = _causes(believed)
    if kind is Kind.EXPLAINED:
        return told if told.endswith("?") else f"{told}."
    rest = quantity(unexplained.share.value, "1")
    return f"{told}{'' if told.endswith('?') else '.'} {rest} of the difference remains unexplained."


def _possible(causes: Sequence[Cause]) -> str:
    """Return the believed causes, which explain a part, else the likeliest of those that explain more."""
    believed = [cause for cause in causes if cause.believed]
    if believed:
        parts = (f"{either(_not_excluded(cause))} explains {quantity(cause.share.value, '1')}" for cause in believed)
        return f"{', '.join(parts)} of the difference, no known effect the rest"
    doubtful = [cause for cause in causes if cause.probability >= LISTED and not cause.believed]
    whole = [cause for cause in doubtful if cause.share.value >= PARTLY_SHARE]
    best = max(whole, key=lambda cause: cause.probability, default=None)
    if best is None:
        return "no known effect explains it"
    return f"{name(best.effect)} may be the cause, with probability {quantity(best.probability, '1')}"


def _pings(count: int) -> str:
    return f"{count:,} ping{'' if count == 1 else 's'}"


def _causes(causes: Sequence[Cause]) -> str:
    if len(causes) == 1:
        return ambiguous(causes[0])
    told = ". ".join(symptom(cause) for cause in causes[:2])
    more = len(causes) - 2
    return told + (f". {more} smaller cause{'s' if more > 1 else ''} beside" if more > 0 else "")


def _would_show(could_have_seen: Sequence[Visible]) -> str:
    chosen = _first(could_have_seen)
    return f": {' or '.join(visible(each) for each in chosen)} would have shown" if chosen else ""


def _needs(could_have_seen: Sequence[Visible]) -> str:
    chosen = _first(could_have_seen)
    return f"; the smallest visible change is {' or '.join(visible(each) for each in chosen)}" if chosen else ""


def _first(could_have_seen: Sequence[Visible]) -> list[Visible]:
    by_name = {each.effect: each for each in could_have_seen}
    chosen = [by_name[effect] for effect in FIRST if effect in by_name]
    return (chosen or list(could_have_seen))[:2]


def silent(diagnosis: Diagnosis) -> bool:
    """Return whether no ping of the recording had an echo."""
    return not bool(diagnosis.recorded.reading.echo.any())


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict as one sentence."""
    return SILENT if silent(diagnosis) else diagnosis.verdict.summary


def fit_line(verdict: Verdict) -> str:
    """Return the errors of simulation and corrected model on unseen visits as a sentence."""
    test = verdict.held_out
    before, after = (quantity(score.crps_m, "m") for score in (test.before, test.after))
    corrected = f", corrected model {after}" if test.after != test.before else ""
    limit = quantity(test.repeatability_m, "m")
    pings = f"{test.n_pings:,} unseen pings"
    own = f"{limit} if predicted from its own nearest positions"
    return f"Mean prediction error on {pings}: simulation {before}{corrected}; {own}."


def one_line(diagnosis: Diagnosis) -> str:
    """Return a diagnosis in one line."""
    verdict = diagnosis.verdict
    causes = ", ".join(f"{cause.effect} {quantity(cause.probability, '1')}" for cause in verdict.causes)
    found = f" ({causes})" if causes else ""
    return f"<Diagnosis of {diagnosis.recording}: {verdict.verdict}{found}, {len(diagnosis.recorded):,} pings>"


def summary_lines(diagnosis: Diagnosis) -> list[str]:
    """Return a diagnosis as at most eleven lines of text, warnings first."""
    verdict = diagnosis.verdict
    lines = [f"warning: {warning}" for warning in verdict.warnings[:3]]
    if len(verdict.warnings) > 3:
        lines[2:] = [f"warning: {len(verdict.warnings) - 2} more; see the report"]
    lines.append(headline(diagnosis))
    if silent(diagnosis):
        return lines
    lines += [f"  {explains(cause)}" for cause in verdict.causes[:3]]
    if verdict.verdict in (Kind.PARTLY_EXPLAINED, Kind.UNEXPLAINED):
        where = f": {location(verdict.unexplained.where[0])}" if verdict.unexplained.where else ""
        lines.append(f"  unexplained: {with_interval(verdict.unexplained.share)} of the difference{where}")
    if verdict.verdict is Kind.NONE:
        lines += [f"  too small to matter: {location(each)}" for each in verdict.unexplained.where[:1]]
    if verdict.verdict is not Kind.TOO_LITTLE_DATA:
        lines.append(fit_line(verdict))
    return lines + [f"next: {measurement(each)}" for each in verdict.next_measurement[:2]]


def measurement(proposed: Measurement) -> str:
    """Return a measurement in words, with the number of pings where it is one of many."""
    return proposed.do + (f" ({_pings(proposed.pings)})" if proposed.pings > 1 else "")
