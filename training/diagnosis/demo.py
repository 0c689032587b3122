"""Demonstration in three minutes: conceal an effect, record, diagnose, correct the model, and park with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from rich.console import Console

from acquisition import Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.io.places import OutputFolder
from acquisition.limits import OneOf, Seed
from acquisition.survey.plan import SurveyPlan
from acquisition.survey.session import Session
from acquisition.survey.sources import RigSource
from noise.discrepancy.result import Diagnosis
from sonar_gym.agent import load_agent
from training.common.progress import bar
from training.diagnosis import diagnose
from training.diagnosis.demo_page import CORRECTED, DemoResult, gif, reason, render
from training.diagnosis.drive import Drive, drive
from training.diagnosis.envelope import CONCEALED, Envelope, conceal

PLAN = SurveyPlan(
    angles_deg=(0.0, 9.0, 18.0, 27.0),
    distances_mm=(150.0, 250.0, 350.0, 500.0, 700.0, 900.0, 1200.0, 1500.0, 1800.0, 2100.0, 2400.0, 2700.0, 3000.0),
    pings=20,
    facing=True,
)
HIDDEN = ["temperature_c", "humidity_pct"]  # columns that would reveal the effect
SONARS = ("ideal", "srf08-mlp")
AGENT = "srf08-mlp, trained agent"  # the other drives are those of the scripted driver


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym demo`."""

    out: OutputFolder = Path("demo")
    """Output folder: report.html, parking.gif, both recordings, the diagnosis, the corrected model."""
    seed: Seed = 12
    """Seed; the same seed gives the same demonstration."""
    conceal: Annotated[str, OneOf(CONCEALED)] | None = None
    """Effect to conceal (sound_speed, zero_offset, dropped_reading); drawn from the seed by default."""


def main(args: Args) -> None:
    """Run the demonstration and print its results."""
    console = Console(highlight=False, soft_wrap=True)
    setup = Setup(gain=31)
    changed, envelope = conceal(setup, np.random.default_rng([args.seed, 0]), args.conceal)
    console.print(f"[bold]1[/] an effect is concealed in the sonar; SHA-256 of envelope.json: {envelope.seal}")
    simulated = record(setup, args.out / "simulated.csv", args.seed, 1)
    recorded = record(changed, args.out / "recorded.csv", args.seed, 2)
    console.print(f"[bold]2[/] recorded {len(recorded)} pings with the effect and {len(simulated)} without it")
    diagnosis = diagnose.examine(
        diagnose.Args(args.out / "recorded.csv", args.out / "diagnosis", simulated=args.out / "simulated.csv")
    )
    console.print("[bold]3[/] " + "\n  ".join(diagnose.summary(diagnosis, args.out / "diagnosis")))
    drives = park(args)
    for name, one in drives.items():
        console.print(f"[bold]4[/] sonar {name}: {one.summary}")
        if name == CORRECTED and not one.success:
            console.print(f"  why: {reason(one, diagnosis)}")
    finish(args, envelope, diagnosis, drives)
    console.print(f"[bold]5[/] concealed effect: {envelope.effect}: {envelope.description}")
    console.print(f"see {args.out / 'report.html'} and {args.out / 'parking.gif'}")


def record(setup: Setup, path: Path, seed: int, stream: int) -> Recording:
    """Record the survey on the rig, without the columns that would reveal the effect."""
    path.unlink(missing_ok=True)
    with bar(f"recording {path.name}", PLAN.pings * len(PLAN)) as update:
        Session(PLAN, RigSource(Rig(Unit.nominal(), setup), seed * 10 + stream), path).run(update)
    recording = Recording.load(path)
    recording = replace(recording, table=recording.table.drop(columns=HIDDEN))
    recording.save(path)
    return recording


def park(args: Args) -> dict[str, Drive]:
    """Park on one street with the ideal, learned and, if there is one, corrected sonar, and with the shipped agent."""
    corrected = args.out / "diagnosis" / "corrected"
    sonars = {name: name for name in SONARS} | ({CORRECTED: str(corrected)} if corrected.exists() else {})
    with bar("parking", len(sonars) + 1) as update:
        drives = {}
        for k, (name, sonar) in enumerate(sonars.items()):
            drives[name] = drive(sonar, args.seed)
            update(k + 1, len(sonars) + 1)
        drives[AGENT] = drive(SONARS[-1], args.seed, load_agent())
    return drives


def finish(args: Args, envelope: Envelope, diagnosis: Diagnosis, drives: dict[str, Drive]) -> None:
    """Write the concealed effect, the film and the page."""
    envelope.save(args.out / "envelope.json")
    film = gif(drives, args.out / "parking.gif")
    result = DemoResult(envelope, diagnosis, drives, film, args.seed)
    render(result, args.out / "report.html")
