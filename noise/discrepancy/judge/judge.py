"""What may be claimed of an explanation, given what it gains and what it leaves over."""

from __future__ import annotations

from collections.abc import Sequence

from noise.discrepancy.checks.transient import SURE_P
from noise.discrepancy.common.rules import AIR, SURE, TIE
from noise.discrepancy.judge.verdict import Named, Rest
from noise.discrepancy.locate.locate import ALARM, Finding
from noise.discrepancy.locate.matched import Matched
from noise.discrepancy.name.explanation import Explained
from noise.discrepancy.name.search import Search
from noise.effects import CATALOGUE, Parameter
from noise.fitting.fit import Fit, maximise
from noise.fitting.stack import JITTER, Key
from noise.fitting.starts import fitting_value

SEEN = 0.05  # p-value of a scan, above which it bears out nothing; ours
# of an effect that nothing else bears out, and its standard errors: in 142 recordings that nothing was wrong with, none
# that the scan did not see gained more than 17 nats on 2.7 standard errors, or 11 nats on 3 and more; ours
PLAIN_NATS, PLAIN_T = 15.0, 3.0
SURE_SCAN = 0.005  # p-value of a scan below which that is enough, whatever is left on unseen cells
CATCH_ALL = ("spike", "noise_burst", "stale_repeat", "dropped_reading", "false_alarm", "stuck", "scintillation")
MEMORY = ("transient", "trailing", "grip", "window", "still", "kept", "play")
# what no law of single readings, or none of those named, holds
BEYOND_LAWS = (*MEMORY, "company", "form", "selective", "fading", "edge")
# found by looks of their own, which no scan of conditions has to bear out
OWN_LOOKS = ("rhythm", "smooth", "steps", *BEYOND_LAWS)
# what readings of one cell do among themselves and after each other, which another day changes: hides no cause
SHAPES = ("skew", "spread", "time_correlation")
LEFT_SHARE = 0.5  # of what was explained: what is left weighs too much for the explanation to be believed; ours
# the same for what a learner makes of it: memory is not the shape of a law
LEARNED_SHARE = {"conditions": 0.5, "memory": 0.02}
SMALL_SHARE = 0.02  # of what was explained: less is the shape of a law, not another cause; ours
EDGE = 0.01  # of the width of its bounds, within which a parameter lies at one; ours
LESS = 0.2  # of a size at the edge, that is taken off it to see whether less would do; ours
NEEDED = 0.05  # of the gain, that has to be lost then: a size that fits and is free loses a twenty-fifth of it; ours


def of_the_day(named: Sequence[Named], gain: float, p_scan: float) -> bool:
    """Tell whether all that is named is how the air moves, that nothing is located by and that gains little."""
    sure = max((AIR.get(n.effect, 0.0) for n in named), default=SURE)
    return gain < sure and p_scan > ALARM and all(n.effect in AIR for n in named)


def may_be_the_laws(
    named: Sequence[Named], gain: float, p_scan: float, matched: Matched | None, counted_nats: float = SURE
) -> bool:
    """Tell whether what is named may be the error of a law that stands for a simulation: faint, borne out by nothing.

    Stays that it strikes, in numbers beyond chance, bear it out. Without them positions that both files share do or do
    not; where they share none, the scan does, or a gain that is many standard errors over stays.

    Args:
        named: the effects.
        gain: of all of them together, nats.
        p_scan: of the scan.
        matched: what positions that both files share say; None where they share none.
        counted_nats: gain of a fault that is enough, since the stays that it strikes were counted.
    """
    if gain >= SURE or any(CATALOGUE[n.effect].localised and n.gain_nats >= counted_nats for n in named):
        return False
    if matched is not None:
        return not matched.differs
    return p_scan > SEEN and not any(_plain(n) for n in named)


def _plain(named: Named) -> bool:
    enough = named.gain_nats >= PLAIN_NATS and named.gain_nats >= PLAIN_T * named.gain_se
    return enough and named.effect not in AIR


def judge(named: Sequence[Named], rest: Rest, gain: float, p_scan: float) -> str:
    """Return the kind of verdict.

    A large gain is never enough to name: what is left over must not weigh as much as what was explained, and an
    effect that can pass for anything (a replaced reading) is not believed while structure remains.
    """
    learned = rest.learned_nats
    if not named:
        clear = learned > 0.0 or any(finding.aspect in OWN_LOOKS for finding in rest.findings)
        seen = p_scan <= SURE_SCAN or (p_scan < ALARM and any(not finding.carried for finding in rest.findings))
        return "unknown" if rest.present and (seen or clear) else "none"
    if rest.present and all(n.effect == JITTER for n in named):
        return "unknown"
    if learned > LEARNED_SHARE[rest.learned_of] * gain or beyond_any_law(rest):
        return "unknown"
    left = sum(finding.nats for finding in rest.findings if finding.aspect not in SHAPES)
    # scatter explains nothing: it is what is left over by another name
    gain -= sum(n.gain_nats for n in named if n.effect == JITTER)
    if rest.present and left > SMALL_SHARE * gain:
        catch_all = all(n.effect in CATCH_ALL for n in named)
        return "unknown" if catch_all or left > LEFT_SHARE * gain else "named_with_rest"
    return "confounded" if any(n.indistinguishable_from for n in named) else "named"


def beyond_any_law(rest: Rest) -> bool:
    """Tell whether readings show what no law of single readings or none that is named, holds."""
    return any(finding.aspect in BEYOND_LAWS and finding.p_value < SURE_P for finding in rest.findings)


def at_the_edge(search: Search, why: Explained) -> list[Finding]:
    """Return what an explanation needs that lies at the edge of the plausible, as findings everywhere.

    A cause that moves the target's echo, and would have to be as great as such a cause can be, is none: it stands in
    for another of a form that it nearly has. Where a lesser one does nearly as well, nothing has to be: how steep a
    beam is beyond the edge of hearing, no reading tells. What an emulator has found by itself does not count.

    Args:
        search: its readings.
        why: the explanation.
    """
    found = [_extreme_in(fit, search, why) for fit in why.final.fits]
    return list({finding.place: finding for each in found for finding in each}.values())


def _extreme_in(fit: Fit, search: Search, why: Explained) -> list[Finding]:
    """Return the same of one fit."""
    stack = fit.stack
    keys = [key for key in search.keys(why.chosen) if key in fit.free]
    own = [key for key in keys if stack.get(key) != search.base.get(key)]
    extreme = [key for key in own if _extreme(stack.parameter(key), stack.get(key))]
    told = [key for key in extreme if fitting_value(stack, key, search.both) is not None]
    needed = [key for key in told if _missed(fit, key, search) > max(TIE, NEEDED * why.gain)]
    return [_edge(key, stack.get(key), stack.parameter(key).unit, why.gain) for key in needed]


def _missed(fit: Fit, key: Key, search: Search) -> float:
    """Return what is lost, nats, where a parameter is less by a fifth and the others may make up for it."""
    here, null = fit.stack.get(key), fit.stack.parameter(key).null
    others = [other for other in fit.free if other != key]
    less = fit.stack.put([key], [here + LESS * (null - here)])
    return fit.nats - maximise(less, others, search.both, 30, scales=search.scales(search.both)).nats


def _extreme(p: Parameter, value: float) -> bool:
    """Tell whether a size lies at one of its bounds, nothing at all being none; how long something lasts is no size."""
    if p.unit == "s":
        return False
    bounds = (bound for bound in (p.low, p.high) if bound != p.null)
    return any(abs(value - bound) < EDGE * (p.high - p.low) for bound in bounds)


def _edge(key: Key, value: float, unit: str, nats: float) -> Finding:
    return Finding("edge", {}, value, unit, 0.0, nats, (".".join(key), value))
