"""One development trial: a survey of a concealed cause on the rig and its diagnosis from the two recordings."""

from __future__ import annotations

import time
import zlib
from dataclasses import asdict, dataclass, replace

import numpy as np

from acquisition import Ping, Recording
from acquisition.bench import Rig, Setup, Unit
from benchmarks.diagnosis.causes import BY_NAME, CAUSES, Cause
from noise import IdealModel
from noise.discrepancy import diagnose

HIDDEN = ["temperature_c", "humidity_pct", "gain", "range_mm"]
SIZES = (0.25, 0.5, 1.0, 2.0)
POSITIONS, PINGS, RUNS, MOVE_S = 72, 20, 3, 20.0


@dataclass(frozen=True)
class Outcome:
    """Concealed cause and verdict; see `noise.discrepancy.Verdict`."""

    trial: int
    causes: str
    size: float
    same_grid: bool
    verdict: str
    named: str
    rivals: str
    right: bool
    p_value: float
    gain_nats: float
    rest: str
    crps_before: float
    crps_after: float
    describes: bool
    seconds: float


def survey(
    rng: np.random.Generator, interval_s: tuple[float, float], turned: bool, positions: Ping | None = None
) -> Ping:
    """Return the pings of a survey of given or random positions, in `RUNS` runs."""
    if positions is None:
        distance = np.round(np.exp(rng.uniform(np.log(0.25), np.log(3.5), POSITIONS)), 3)
        angle = np.deg2rad(rng.choice([-20.0, -10.0, -5.0, 0.0, 0.0, 5.0, 10.0, 20.0, 30.0], POSITIONS))
        incidence = angle if turned else np.zeros(POSITIONS)
        positions = Ping.of(
            distance=distance, angle=angle, incidence=incidence, reflectance=rng.choice([0.1, 0.9], POSITIONS)
        )
    order = np.repeat(rng.permutation(len(positions)), PINGS)
    wait = rng.uniform(*interval_s, len(order))
    wait[::PINGS] = MOVE_S
    run = np.repeat(np.arange(RUNS), -(-len(order) // RUNS))[: len(order)]
    return replace(positions[order], time=np.round(np.cumsum(wait) - wait[0], 3), run=run)


def record(rig: Rig, ping: Ping, rng: np.random.Generator) -> Recording:
    """Return a recording of the rig without the columns that would reveal the cause."""
    recording = rig.record(ping, rng)
    return replace(recording, table=recording.table.drop(columns=HIDDEN))


def pair_of(cause: Cause | None, size: float, seed: int, trial: int) -> tuple[Recording, Recording, bool]:
    """Return the simulated and real recording of one trial, and whether they share their positions."""
    rng = np.random.default_rng([seed, trial, 77])
    rig = Rig(Unit.draw(1000 * seed + trial + 1), Setup.draw(1000 * seed + trial, gain=24, output="us"))
    rig = replace(rig, setup=replace(rig.setup, temperature_c=19.0))
    interval, turned = (cause.interval_s, cause.turned) if cause else ((0.1, 0.1), bool(rng.random() < 0.3))
    simulator = cause.before(rig) if cause else rig
    real = cause.change(simulator, size, rng) if cause else _other_day(rig)
    same = bool(rng.random() < 0.4)
    first = survey(rng, interval, turned)
    second = survey(rng, interval, turned, first[::PINGS] if same else None)
    return record(simulator, first, rng), record(real, second, rng), same


def _other_day(rig: Rig) -> Rig:
    """Return the rig of a null trial: larger placement errors and slower air."""
    return replace(rig, setup=replace(rig.setup, placement_m=0.004, flutter_tau_s=5.0))


def schedule(trials: int, seed: int) -> list[tuple[str, float]]:
    """Return cause and size of each trial; every fifth trial is a null."""
    out: list[tuple[str, float]] = []
    for k in range(trials):
        name = "null" if k % 5 == 4 else CAUSES[(k - k // 5 + seed) % len(CAUSES)].name
        out.append((name, SIZES[zlib.crc32(f"{seed} {k}".encode()) % len(SIZES)]))
    return out


def run(trial: int, name: str, size: float, seed: int) -> Outcome:
    """Record and diagnose one trial."""
    cause = BY_NAME.get(name)
    simulated, recorded, same = pair_of(cause, size, seed, trial)
    start = time.perf_counter()
    verdict = diagnose(IdealModel(), recorded, simulated=simulated, seed=trial).verdict
    seconds = time.perf_counter() - start
    named = [n.effect for n in verdict.effects]
    rivals = sorted({e for n in verdict.effects for e in n.indistinguishable_from})
    return Outcome(
        trial,
        name,
        size,
        same,
        verdict.verdict,
        " ".join(named),
        " ".join(rivals),
        right(cause, verdict.verdict, named, rivals),
        verdict.p_value,
        sum(n.gain_nats for n in verdict.effects),
        (verdict.unknown.description or "")[:200],
        verdict.held_out.before.crps_mm,
        verdict.held_out.after.crps_mm,
        verdict.baseline_check.describes_simulation,
        round(seconds, 1),
    )


def right(cause: Cause | None, verdict: str, named: list[str], rivals: list[str]) -> bool:
    """Return whether a verdict is right: none for a null, unknown outside the catalogue, else the cause or a rival."""
    if cause is None:
        return verdict == "none"
    if not cause.accepted:
        return verdict == "unknown"
    return verdict != "unknown" and bool(set(cause.accepted) & {*named, *rivals})


def row(outcome: Outcome) -> dict[str, object]:
    """Return an outcome as a row of trials.csv."""
    return asdict(outcome)
