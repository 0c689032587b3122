"""From a model and a recording to a verdict and a corrected model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import Ping, Reading, Recording, SettingError
from acquisition.arrays import Floats
from noise.discrepancy.baseline.emulate import Baseline, Simulator, baseline_of
from noise.discrepancy.common.rules import spread_over_blocks
from noise.discrepancy.common.splits import Split
from noise.discrepancy.common.workers import ALONE, Workers
from noise.discrepancy.judge.judge import SURE_SCAN, at_the_edge, beyond_any_law, judge, may_be_the_laws, of_the_day
from noise.discrepancy.judge.next_measurement import Measurement, next_measurement
from noise.discrepancy.judge.rest import check_rest, located, with_more
from noise.discrepancy.judge.scatter import SCATTER, changed_scatter
from noise.discrepancy.judge.steps import coarser_steps, cut_instead, steps_left
from noise.discrepancy.judge.verdict import HeldOut, Named, Rest, Score, Verdict
from noise.discrepancy.locate.gained import gained, with_gained
from noise.discrepancy.locate.locate import ALARM, Finding, findings
from noise.discrepancy.locate.matched import Matched, compare
from noise.discrepancy.locate.residuals import Residuals, residuals
from noise.discrepancy.locate.scan import Blocks, scan
from noise.discrepancy.name.explanation import Z90, Explained, conclude, intervals
from noise.discrepancy.name.pairs import with_pairs
from noise.discrepancy.name.rivals import Rival, in_disguise, posterior, rivals
from noise.discrepancy.name.search import Progress, Search
from noise.effects import CATALOGUE
from noise.effects.medium import CELSIUS
from noise.fitting.batch import Batch
from noise.fitting.empirical import EmpiricalModel
from noise.fitting.fit import Fit, best_of, log_likelihood
from noise.fitting.stack import JITTER, NUISANCES, VISITS, Stack
from noise.fitting.starts import nuisance_starts
from noise.fitting.threads import one_thread
from noise.fitting.visit_effects import shared_scatter
from noise.model import SonarModel

LASTING_SHARE = 0.8  # of the false alarms of a scan, for what lasts; the rest is for what a day may change; ours
LEAST_P = 1e-12  # no p-value of a model of the world means more
CRPS_LEVELS = np.linspace(0.025, 0.975, 20)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """A verdict, the corrected model, and what figures and tables are made of.

    Attributes:
        verdict: everything that is claimed.
        corrected: the model with what was found in it; sample it, save it, drive with it. What cells share is in it
            as scatter from ping to ping: a single reading, of whose cell nothing else is known.
        given: the model that was handed in.
        shown_before: the model, or the physical law that stands for the simulated readings: "before" in every score.
        before: the law that stood for it in the search, its scatter fitted.
        explanation: what was found, as the stack of effects and nuisances that the rivals are held against.
        split: the parts; the vault was used for `verdict.held_out` alone.
        rivals: everything that was tried in the place of each named effect.
        recording: its name; `pings` of it were used, `unanswered` were not.
    """

    verdict: Verdict
    corrected: EmpiricalModel
    given: SonarModel | Simulator
    shown_before: SonarModel
    before: EmpiricalModel
    explanation: Stack
    split: Split
    rivals: tuple[Rival, ...]
    recording: str
    pings: int
    unanswered: int

    def to_verdict(self) -> dict[str, Any]:
        """Return the content of verdict.json."""
        return self.verdict.to_dict()


@one_thread()
def diagnose(
    model: SonarModel | Simulator,
    recording: Recording,
    *,
    simulated: Recording | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    without: Sequence[str] = (),
    workers: int = 1,
) -> Diagnosis:
    """Say where a recording differs from a model, why, by how much, and correct the model.

    Args:
        model: what the simulation uses. A `PhysicalModel` is taken as it is and `IdealModel` as one without effects;
            any other (Gaussian, learned) is replaced by an emulator that is fitted to its own samples and checked
            (`baseline_check`): what the emulator does not hold of it is not corrected. A plain function
            `simulator(pings, rng) -> readings` (a `Reading`, or ranges in m with 0 for no echo) is asked for fresh
            readings under the recording's own conditions.
        recording: of the real sonar.
        simulated: readings of a simulator on its own conditions; it then stands in the place of `model`.
        seed: of splits, draws and starting points; the same seed gives the same verdict.
        progress: called with a message and the share done, now and then.
        without: effects that are known not to be there: they are never named.
        workers: processes that share the work; the verdict is the same with any number of them.

    Raises:
        RecordingError: the recording holds no answered ping.
        SettingError: `without` names what is not in the catalogue.
    """
    tell = progress or (lambda message, share: None)
    _check_known(without)
    tell("learning what the simulation says", 0.02)
    crew = Workers(workers)
    crew.start()
    base = baseline_of(model, recording, simulated, seed, crew)
    batch = base.with_twins(Batch.of(recording))
    split = Split.of(batch, np.random.default_rng([seed, 1]))
    search, fitted = prepared(base, split, seed, tell, tuple(without), crew)
    tell("locating", 0.08)
    peer = base.peer(seed)
    rng = np.random.default_rng([seed, 2])
    seen = residuals(fitted.stack, search.both, rng)
    where, p_scan = _where(seen, search.both, peer, rng)
    why = _explained(base, search)
    tell("checking what is left", 0.7)
    rng = np.random.default_rng([seed, 4])
    rest = check_rest(search, why.chosen, why.cross, rng, split.both, peer, base.usual(seed, batch.resolution))
    rest = with_more(rest, at_the_edge(search, why))
    tell("weighing rivals", 0.8)
    named, all_rivals = _name(base, search, why, seed, believed=not beyond_any_law(rest))
    beside = _beside(base, search, why)
    if base.own is not None:
        names = [*why.chosen, *(one.effect for one, _ in beside)]
        rest = with_more(rest, steps_left(base.own.whole.resolution, search.both, names))
    gain = why.gain + sum(float(nats.sum()) for _, nats in beside)
    matched = None if base.own is None else compare(base.own.whole, batch, np.random.default_rng([seed, 10]))
    verdict = _verdict(base, where, p_scan, [*named, *(one for one, _ in beside)], rest, gain, search, matched)
    if why.chosen and verdict.claims:
        told = gained(fitted.stack, why.final.stack, search.both, seen, verdict.p_value, rng, peer)
        verdict = replace(verdict, where=with_gained(verdict.where, told))
    before = _before(base, fitted, beside)
    # what was chosen and not named in the end corrects nothing
    after, single = (why.final.stack, why.final.single) if verdict.effects else (fitted.stack, fitted.stack)
    corrected = corrected_model(single, recording, split.both)
    held = _held_out(base.raw, corrected, before, after, split.vault)
    ahead = _ahead(base, why, all_rivals, seed, search.both) if verdict.effects else ()
    tell("done", 1.0)
    return Diagnosis(
        replace(verdict, held_out=held, next_measurement=ahead),
        corrected,
        model,
        base.raw,
        corrected_model(fitted.stack, recording, split.both),
        after,
        split,
        tuple(all_rivals),
        recording.name,
        len(batch),
        len(recording) - len(batch),
    )


def _where(seen: Residuals, batch: Batch, peer: Blocks | None, rng: np.random.Generator) -> tuple[list[Finding], float]:
    """Return what a scan locates, and the p-value of what is not of the day in it."""
    scanned = scan(seen, batch, rng, peer)
    where = findings(seen, scanned, batch, peer)
    lasting = scanned.lasting.p_value(scanned.lasting.best) / LASTING_SHARE
    # what one day may change is looked at besides, where it is more than a day changes
    besides = [finding.p_value / (1.0 - LASTING_SHARE) for finding in where if not finding.carried]
    return where, min(lasting, *besides, 1.0)


def _explained(base: Baseline, search: Search) -> Explained:
    """Search, and leave out what only repairs the law that stands for the simulation."""
    chosen, without, cross = search.run()
    chosen, cross = with_pairs(search, chosen, without, cross)
    chosen, cross = base.without_repairs(search, chosen, cross, without)
    if base.own is not None:
        chosen, cross = cut_instead(base.own.whole.resolution, search, chosen, cross)
    return Explained(chosen, without, cross, conclude(search, cross, chosen))


def _ahead(
    base: Baseline, why: Explained, all_rivals: Sequence[Rival], seed: int, batch: Batch
) -> tuple[Measurement, ...]:
    """Return what to measure next to tell apart what the data did not."""
    surviving = [(r.replaces, r.effect, r.stack) for r in all_rivals if r.survives]
    simulation = base.stack if base.own is not None else None
    return tuple(next_measurement(why.final.stack, surviving, seed, simulation, batch.ping))


def _beside(base: Baseline, search: Search, why: Explained) -> list[tuple[Named, Floats]]:
    """Return what only a simulation known by its readings tells besides: another scatter, coarser steps."""
    if base.own is None:
        return []
    scatter = None
    if JITTER not in search.never:
        known = base.check.wholly
        scatter = changed_scatter(base.stack, base.own.whole, search, why.chosen, why.cross, known)
    steps = coarser_steps(base.own.whole.resolution, search.both, why.final.stack, search.never, why.chosen)
    return [found for found in (scatter, steps) if found is not None]


def _before(base: Baseline, fitted: Fit, beside: Sequence[tuple[Named, Floats]]) -> Stack:
    """Return the law without what was found; with the simulation's own scatter, where that is part of it."""
    if all(named.effect != JITTER for named, _ in beside):
        return fitted.stack
    return fitted.stack.put(SCATTER, [base.stack.get(key) for key in SCATTER])


def _check_known(names: Sequence[str]) -> None:
    unknown = [name for name in names if name not in CATALOGUE]
    if unknown:
        raise SettingError(f"{unknown[0]!r} is no effect of the catalogue: there are {', '.join(CATALOGUE)}")


def prepared(
    base: Baseline,
    split: Split,
    seed: int,
    tell: Progress | None = None,
    never: tuple[str, ...] = (),
    workers: Workers = ALONE,
) -> tuple[Search, Fit]:
    """Return the search, its base fitted in nuisances alone."""
    batch = split.discover.thin(4000)
    fitted = best_of(nuisance_starts(base.stack, batch), NUISANCES, batch, 80)
    rules = base.rules(split.both)
    parts = (split.discover, split.confirm, split.both)
    search = Search(fitted.stack, *parts, seed, rules, tell, never=never, workers=workers)
    return search, fitted


def _name(
    base: Baseline, search: Search, why: Explained, seed: int, believed: bool = True
) -> tuple[list[Named], list[Rival]]:
    """Return every chosen effect with intervals, gain and rivals.

    Where readings show what none of them holds, no rival is weighed against an explanation that nobody believes, and
    its effects have no probability.
    """
    chosen, final = why.chosen, why.final
    if not chosen:
        return [], []
    known = intervals(final, search.both, base.stack, base.untied(search.both))
    named, all_rivals = [], []
    for k, name in enumerate(chosen):
        gain, _ = search.contribution(chosen, why.cross, name)
        own = rivals(search, why, name, np.random.default_rng([seed, 3, k])) if believed else []
        all_rivals += own
        alike = tuple(rival.effect for rival in own if rival.survives)
        alike += in_disguise(search, (name, *alike), chosen)
        own_keys = [key for key in known if key[0] == name]
        parameters = {key[1]: known[key] for key in own_keys}
        told = _told(base, final.single.put(own_keys, [known[key].value for key in own_keys]), name)
        weight, error = posterior(own) if believed else 0.0, spread_over_blocks(gain)
        named.append(Named(name, alike, weight, parameters, float(gain.sum()), error, told))
    return named, all_rivals


def _told(base: Baseline, after: Stack, name: str) -> str:
    """Return the statement of an effect; of a simulation known by its readings alone, against what it does itself."""
    before = base.stack
    text = after.known[name](**after.values[name]).statement()
    if base.own is not None and name == "sound_speed":
        return compared_air(before.get((name, "temperature_c")), after.get((name, "temperature_c")))
    changed = [p for p in before.known[name].parameters if before.get((name, p.name)) != p.null]
    if name not in before.values or not changed:
        return text
    held = ", ".join(f"{p.name} {before.get((name, p.name)):.3g} {p.unit}" for p in changed)
    return f"{text} (The simulation itself behaves as with {held}.)"


def compared_air(before_c: float, after_c: float) -> str:
    """Return how the air differs from a simulation whose own temperature nobody stated."""
    error = ((CELSIUS + before_c) / (CELSIUS + after_c)) ** 0.5 - 1.0
    return (
        f"Readings run {'long' if error >= 0 else 'short'} by {100 * abs(error):.2g} % of distance against the "
        f"simulation: the air was {abs(after_c - before_c):.0f} K {'warmer' if error < 0 else 'colder'} than it has it."
    )


def _verdict(
    base: Baseline,
    where: Sequence[Finding],
    p_scan: float,
    named: Sequence[Named],
    rest: Rest,
    gain: float,
    search: Search,
    matched: Matched | None,
) -> Verdict:
    """Return the verdict, its held-out part still open."""
    unseen = base.own is not None and may_be_the_laws(named, gain, p_scan, matched, search.rules.sweeping_nats)
    if not rest.present and (unseen or of_the_day(named, gain, p_scan)):
        named, gain = [], 0.0
    p_gain = min(1.0, len(search.candidates()) ** len(named) * float(np.exp(-max(gain, 0.0)))) if named else 1.0
    if not named and not rest.present and p_scan <= SURE_SCAN and (matched is None or matched.differs):
        rest = located(where, p_scan)
    kind = judge(named, rest, gain, p_scan)
    shown = tuple(where) if kind != "none" else tuple(f for f in where if f.p_value < ALARM)
    empty = HeldOut("cells", 0, Score(0.0, 0.0), Score(0.0, 0.0), 0.0, 0.0)
    p = max(LEAST_P, min(1.0, 2.0 * min(p_scan, p_gain)))
    if kind in ("none", "named", "confounded"):
        rest = replace(rest, present=False, description=None)
    return Verdict(kind, p, shown, tuple(named), rest, empty, (), base.check, tuple(search.attempts), matched)


def corrected_model(stack: Stack, recording: Recording, batch: Batch) -> EmpiricalModel:
    """Return the model of a stack: what cells share becomes scatter, the register the recording's where coarser.

    Args:
        stack: the explanation.
        recording: it is of.
        batch: the cells that share it: where a simulation knows where they lie, only what it does not know scatters.
    """
    sigma = float(np.hypot(stack.get((JITTER, "sigma_m")), shared_scatter(stack.build()[1], batch)))
    stack = stack.put([(JITTER, "sigma_m")], [sigma]).without(VISITS)
    effects = [stack.known[name](**values) for name, values in stack.values.items()]
    return EmpiricalModel(effects, max(stack.resolution, recording.resolution), stack.max_range)


def _held_out(raw: SonarModel, corrected: SonarModel, before: Stack, after: Stack, vault: Batch) -> HeldOut:
    """Open the vault: score before and after on cells that nothing was fitted to.

    Likelihoods are of readings given those before in their cell; CRPS is of single readings under the two models.
    """
    nats = [log_likelihood(stack, vault) for stack in (before, after)]
    gain = vault.visit_sums(nats[1] - nats[0])
    error = spread_over_blocks(gain)
    plain, n = gain.sum() / len(vault), len(vault)
    scores = [crps_mm(model, vault.ping, vault.past, vault.reading) for model in (raw, corrected)]
    first, last = (Score(float(x.mean()), c) for x, c in zip(nats, scores, strict=True))
    return HeldOut("cells", n, first, last, float(plain - Z90 * error / n), float(plain + Z90 * error / n))


def crps_mm(model: SonarModel, ping: Ping, past: Reading, reading: Reading) -> float:
    """Return the mean CRPS of echoes under a model's law given that there is an echo, mm."""
    return _crps(model.law(ping, past).quantile, reading)


def _crps(quantile: Any, reading: Reading) -> float:
    """Return twice the mean pinball loss over levels, which is the CRPS up to the levels' spacing, mm."""
    if not reading.echo.any():
        return 0.0
    total = np.zeros(len(reading))
    for level in CRPS_LEVELS:
        difference = reading.range - quantile(level)
        total += 2.0 * np.maximum(level * difference, (level - 1.0) * difference)
    return float(1000.0 * (total / len(CRPS_LEVELS))[reading.echo].mean())
