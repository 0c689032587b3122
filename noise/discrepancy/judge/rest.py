"""Whether the best explanation leaves anything over, on cells it was not fitted to, and what that looks like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from noise.discrepancy.checks.company import USUAL, company
from noise.discrepancy.checks.fading import fading
from noise.discrepancy.checks.grip import grip
from noise.discrepancy.checks.held import Still, held
from noise.discrepancy.checks.remainder import NOTHING, Remainder, remainder
from noise.discrepancy.checks.rhythm import rhythm
from noise.discrepancy.checks.selective import selective
from noise.discrepancy.checks.smooth import Smooth, smooth, wrong_form
from noise.discrepancy.checks.trailing import Trailing, trailing
from noise.discrepancy.checks.transient import transient, windowed
from noise.discrepancy.judge.verdict import Rest
from noise.discrepancy.locate.describe import Formula, formula
from noise.discrepancy.locate.locate import Finding, locate
from noise.discrepancy.locate.residuals import residuals
from noise.discrepancy.locate.scan import Blocks, scan
from noise.discrepancy.name.search import Crossed, Search
from noise.fitting.batch import Batch
from noise.fitting.fit import Fit, refit_without_urn
from noise.fitting.stack import VISITS, Stack

LEVEL = 0.015  # of a false alarm of all looks together; ours
# scans of either part, a beat, three of memory where the target stands and two where it moves, things that answer,
# neighbours that agree, places of faults, fading
LOOKS = 12.0
CLEAR = 15.0  # nats that a learner must gain to count; ours
LEARNED = {
    "conditions": "what is left follows from the conditions, by {nats:.0f} nats on unseen cells",
    "memory": "readings follow what was read before them, by {nats:.0f} nats that no effect explains",
}
_COLUMNS = {"distance_mm": ("distance", "m", 1000.0), "angle_deg": ("angle", "deg", 1.0), "time_s": ("time", "s", 1.0)}
_WORDS = {
    "bias": "readings are off by {mm:+.0f} mm",
    "scale": "readings stray by {percent:+.2f} % of distance",
    "spread": "readings scatter {size:.2g} times as much as expected",
    "skew": "readings lean to one side of what is expected",
    "detection": "echoes are {more} often than expected, by {percent:.1f} % of pings",
    "extra_mode": "{percent:.1f} % of readings are far from what is expected{place}",
    "time_correlation": "successive readings hang together (correlation {size:.2f})",
    "transient": "first readings after a move lean towards the place before, by {mm:.0f} mm",
    "trailing": "readings trail behind a moving target by {size:.2g} {pings}",
    "grip": "readings stay as they were until the target has moved by {mm:.0f} mm or so",
    "window": "after a move the first {size:.1f} readings are still of the place before, as a filter has it",
    "company": "in {percent:.0f} % of stays something else than the target answers, from one place while it lasts",
    "smooth": "positions are off by {mm:.0f} mm (standard deviation), neighbours in {along} alike",
    "form": "positions are off by {mm:.0f} mm (standard deviation) along {along}, which no cause of this form explains",
    "still": "readings do not change by a digit while the target stays",
    "kept": "after {percent:.0f} % of moves readings stay, to the digit, what they were before",
    "play": "positions lie towards the place before, by {mm:.0f} mm",
    "fading": "echoes fail {often} as time goes on, by {percent:.0f} % of pings from the earlier half to the later",
    "selective": "strays, in {percent:.0f} % of stays, go by {along}, where a fault would strike anywhere",
    "edge": "nothing less than a {along} of {size:.3g} {unit} would do, which is the edge of what is plausible",
    "steps": "readings come in steps of {mm:.3g} mm, which are coarser than the simulation's",
    "rhythm": "readings move to and fro by {mm:.1f} mm, once every {period:.4g} s",
}


@dataclass(frozen=True)
class Usual:
    """What looks find in the readings of a simulation itself, under the law that stands for it.

    Attributes:
        remainder: what a learner makes of them; None where the law is the simulation.
        company: share of its stays in which something else than the target answers.
        smooth: how much its stays agree with their neighbours; None where the law is the simulation.
        still: how many of its stays show no change; None where the law is the simulation.
        trailing: how far its readings trail behind a moving target; None where the law is the simulation.
    """

    remainder: Remainder | None = None
    company: float = USUAL
    smooth: Smooth | None = None
    still: Still | None = None
    trailing: Trailing | None = None


def check_rest(
    search: Search,
    chosen: Sequence[str],
    cross: Crossed,
    rng: np.random.Generator,
    whole: Batch,
    peer: Blocks | None = None,
    usual: Usual | None = None,
) -> Rest:
    """Scan the residuals of cells that were not fitted, both ways; take looks of other kinds.

    The least p-value counts, all looks taken. Beside it, a learner without physics says how much it makes of the rest.

    Args:
        search: holds the parts.
        chosen: the effects of the explanation.
        cross: the explanation, fitted on either part.
        rng: for randomised PIT values and flips.
        whole: both parts with every ping of a block, in which a beat shows best; nothing fitted can hold one.
        peer: the simulation that the law stands for.
        usual: what the looks find in the simulation itself.
    """
    usual = usual or Usual()
    fits = ((cross.first, search.discover, search.confirm), (cross.second, search.confirm, search.discover))
    pairs = [(_counted(search, chosen, fit, seen), unseen) for fit, seen, unseen in fits]
    p_values = [scan_p(stack, batch, rng, peer) for stack, batch in pairs]
    beside = beside_scans(search, chosen, pairs[0][0], whole, usual, rng)
    learned = beyond(remainder(pairs[0][0], search.both, rng), usual.remainder)
    if not learned.sure or learned.nats <= CLEAR:
        learned = NOTHING
    p = min(1.0, LOOKS * min(*p_values, *(finding.p_value for finding in beside)))
    if p >= LEVEL and learned is NOTHING:
        return Rest(False, p, None)
    stack, batch = pairs[int(np.argmin(p_values))]
    findings = tuple(finding for finding in beside if LOOKS * finding.p_value < LEVEL)
    if LOOKS * min(p_values) < LEVEL:
        findings += tuple(locate(stack, batch, rng, most=3, peer=peer))
    parts = [in_words(finding) for finding in findings]
    parts += [] if learned is NOTHING else [LEARNED[learned.of].format(nats=learned.nats)]
    told = _told(parts, formula(stack, search.both, rng))
    return Rest(True, min(p, learned.p_value), told, findings, learned.nats, learned.of)


def beside_scans(
    search: Search, chosen: Sequence[str], stack: Stack, batch: Batch, usual: Usual, rng: np.random.Generator
) -> list[Finding]:
    """Return what looks of their own find, whatever their p-values: those that `LOOKS` counts."""
    alike = smooth(stack, batch).finding(usual.smooth)
    if chosen and wrong_form(alike, search.base, stack, batch):
        alike = replace(alike, aspect="form")
    found = [look.finding for look in (transient(batch), rhythm(stack, batch)) if look is not None]
    found += [held(stack, batch, usual.still), company(stack, batch).finding(usual.company), alike]
    moving = (trailing(stack, batch).finding(usual.trailing), grip(stack, batch))
    by_stay = (windowed(batch, rng), *moving, selective(stack, batch, chosen, rng), fading(stack, batch))
    return found + [look for look in by_stay if look is not None]


def beyond(found: Remainder, usual: Remainder | None) -> Remainder:
    """Return a remainder less what the same learner gains on as many blocks of the simulation itself."""
    if usual is None or usual.nats <= 0.0 or usual.n_visits == 0:
        return found
    own = usual.nats * found.n_visits / usual.n_visits
    return replace(found, nats=found.nats - own, error=float(np.hypot(found.error, usual.error)))


def _counted(search: Search, chosen: Sequence[str], fit: Fit, batch: Batch) -> Stack:
    """Return the law of single readings, with what cells carry over from ping to ping."""
    each = refit_without_urn(fit, search.keys(chosen), batch).stack
    return each.put([(VISITS, "ping_correlation")], [fit.stack.get((VISITS, "ping_correlation"))])


def scan_p(stack: Stack, batch: Batch, rng: np.random.Generator, peer: Blocks | None = None) -> float:
    """Return the family-wise p-value of the greatest residual statistic."""
    scanned = scan(residuals(stack, batch, rng), batch, rng, peer)
    return scanned.p_value(scanned.best)


def located(where: Sequence[Finding], p_scan: float) -> Rest:
    """Return a rest that nothing but the first scan shows: what is located beyond doubt is not nothing."""
    lasting = tuple(finding for finding in where if not finding.carried)
    return Rest(True, p_scan, _told([in_words(finding) for finding in lasting]), lasting)


def with_more(rest: Rest, findings: Sequence[Finding]) -> Rest:
    """Return a rest with what is found besides."""
    if not findings:
        return rest
    words = [in_words(finding) for finding in findings]
    told = _told(words) if rest.description is None else "; ".join([*words, rest.description])
    p = min(rest.p_value, *(finding.p_value for finding in findings))
    return replace(rest, present=True, p_value=p, description=told, findings=(*rest.findings, *findings))


def _told(parts: Sequence[str], short: Formula | None = None) -> str:
    """Return the description of what is left, in words and as a short formula."""
    words = "; ".join(parts) or "small misfits that stand out at no single place"
    return f"{words if short is None else f'{words}; {short}'} (a description, not a cause)"


def in_words(finding: Finding) -> str:
    """Return a finding as a phrase."""
    place, period, along = "", 0.0, ""
    if finding.aspect == "rhythm" and finding.place is not None:
        period = finding.place[1]
    elif finding.aspect in ("smooth", "form", "selective") and finding.place is not None:
        along = _COLUMNS.get(finding.place[0], (finding.place[0], "", 1.0))[0]
    elif finding.aspect == "edge" and finding.place is not None:
        along = finding.place[0]
    elif finding.place is not None:
        kind, value = finding.place
        place = f" ({kind} {value:.2f})" if kind == "times distance" else f" ({kind}, {value:.2f} m)"
    text = _WORDS[finding.aspect].format(
        mm=1000.0 * finding.size,
        percent=100.0 * (abs(finding.size) if finding.aspect in ("detection", "fading") else finding.size),
        size=finding.size,
        often="more often" if finding.size > 0 else "less often",
        more="heard less" if finding.size < 0 else "heard more",
        place=place,
        period=period,
        along=along,
        pings="s" if finding.unit == "s" else "pings",
        unit=finding.unit,
    )
    return f"{text} {region_in_words(finding)}".strip()


def region_in_words(finding: Finding) -> str:
    """Return where a finding is, as a phrase; nothing where it is everywhere."""
    parts = []
    for column, (low, high) in finding.region.items():
        name, unit, scale = _COLUMNS.get(column, (column, "", 1.0))
        parts.append(f"{name} {low / scale:.3g} to {high / scale:.3g} {unit}".strip())
    return f"at {' and '.join(parts)}" if parts else ""
