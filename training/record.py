"""Record a survey: with a real sonar, with the waveform rig, or with a real driver over a simulated sonar."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.progress import Progress

from acquisition import EchoStatus, Ping, Recording, SettingError
from acquisition.bench import Rig, Setup, Unit
from acquisition.drivers import DRIVERS, Srf08
from acquisition.drivers.twins import Srf08Twin
from acquisition.plan import PLANS, Cell, Plan
from acquisition.session import Session
from acquisition.sources import DriverSource, RigSource, Source
from training.progress import TERMINAL, bars

Arrange = Callable[[Cell], None]


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym record`.

    Example:
        sonar-gym record --driver rig --plan quick --out rec.csv --seed 1 --unit 7
    """

    out: Path
    """Recording to write; each condition is on disk as soon as it is measured."""
    driver: Literal["rig", "twin", "srf08"] = "rig"
    """rig: simulated waveforms. twin: the SRF08's driver over a simulated SRF08. srf08: a real one on I2C."""
    plan: Literal["quick", "turned", "thesis"] = "quick"
    """quick: 3,600 pings on 120 conditions. turned: 55,296 on 6,912, reflectors turned apart from their bearing.
    thesis: 133,100 pings on 2,662 conditions."""
    resume: bool = False
    """Go on with a recording that was interrupted; plan, seed and settings must be those it was begun with."""
    seed: int = 0
    """Of the order of conditions and of everything random in the rig."""
    pings: int | None = None
    """Pings a condition; as the plan has it if not given."""
    interval_s: float | None = None
    """Seconds from ping to ping; as the plan has it if not given."""
    pose: Literal["plan", "facing", "parallel"] = "plan"
    """How the reflector is turned aside of the axis: facing the sensor, parallel to its face, or as the plan has it."""
    gain: int = 14
    """Code 0..31 of the amplifier's greatest gain."""
    range_register: int = 140
    """0..255; echoes are awaited up to 43 mm * (value + 1)."""
    output: Literal["cm", "inch", "us"] = "cm"
    """Unit in which the sensor counts."""
    echoes: int = 4
    """Echoes of a ping to write down, 1..17."""
    unit: int = 0
    """rig, twin: serial number of the simulated sensor; 0 is the nominal one."""
    temperature_c: float = 19.0
    """Of the air, degC: the rig's own, or what a thermometer beside the real sensor shows."""
    humidity_pct: float = 50.0
    """Of the air, %."""
    bus: int = 1
    """srf08: number of the I2C bus, /dev/i2c-N."""
    address: int = 0x70
    """srf08: 7-bit address, 112..127."""


def main(args: Args) -> None:
    """Record, show how far it is, and say what came of it."""
    plan = plan_of(args)
    with bars() as bar:
        source = SOURCES[args.driver](args, lambda cell: _ask_operator(cell, bar))
        session = Session(plan, source, args.out, args.resume, args.echoes)
        task = bar.add_task(args.out.name, total=len(plan) * plan.pings, visible=False)
        session.run(lambda done, total: bar.update(task, completed=done, total=total, visible=True))
    print(summary(Recording.load(args.out), args.out))


def plan_of(args: Args) -> Plan:
    """Return the plan with what the settings change."""
    plan = PLANS[args.plan]
    pings = plan.pings if args.pings is None else args.pings
    facing = plan.facing if args.pose == "plan" else args.pose == "facing"
    interval_s = plan.interval_s if args.interval_s is None else args.interval_s
    incidences = plan.incidences_deg if args.pose == "plan" else ()
    return replace(plan, pings=pings, interval_s=interval_s, facing=facing, incidences_deg=incidences, seed=args.seed)


def summary(recording: Recording, path: Path) -> str:
    """Return a line on what was recorded."""
    status = recording.reading.status
    shares = [100.0 * float(np.mean(status == kind)) for kind in (EchoStatus.ECHO, EchoStatus.NO_ECHO)]
    lost = int((status == EchoStatus.NO_ANSWER).sum())
    return (
        f"{path}: {len(recording)} pings on {recording.cell.max() + 1} conditions; "
        f"{shares[0]:.1f} % echoes, {shares[1]:.1f} % silent, {lost} without answer"
    )


def _rig(args: Args) -> Rig:
    setup = Setup(
        gain=args.gain,
        range_register=args.range_register,
        output=args.output,
        temperature_c=args.temperature_c,
        humidity_pct=args.humidity_pct,
    )
    return Rig(Unit.draw(args.unit) if args.unit else Unit.nominal(), setup)


def _rig_source(args: Args, arrange: Arrange) -> Source:
    return RigSource(_rig(args), args.seed)


def _twin_source(args: Args, arrange: Arrange) -> Source:
    if args.resume:
        raise SettingError("--resume does not go with --driver twin, which forgets its state; record it anew")
    twin = Srf08Twin(_rig(args), np.random.default_rng([args.seed, args.unit]))
    sonar = Srf08(twin, twin.address, **_registers(args), sleep=twin.clock.sleep, clock=twin.clock)

    def place(cell: Cell) -> None:
        bearing, incidence = np.deg2rad([cell.angle_deg, cell.incidence_deg])
        twin.place(Ping.of(cell.distance_mm * 1e-3, bearing, incidence, cell.reflectance))

    return DriverSource(sonar, place, _columns(args), sleep=twin.clock.sleep, clock=twin.clock, simulated=True)


def _srf08_source(args: Args, arrange: Arrange) -> Source:
    sonar = DRIVERS["srf08"].open(args.bus, address=args.address, **_registers(args))
    TERMINAL.print(f"{sonar} answers, revision {sonar.revision()}")
    return DriverSource(sonar, arrange, _columns(args))


# how each kind of driver becomes something that a session measures with
SOURCES: dict[str, Callable[[Args, Arrange], Source]] = {
    "rig": _rig_source,
    "twin": _twin_source,
    "srf08": _srf08_source,
}


def _registers(args: Args) -> dict[str, Any]:
    return {"gain": args.gain, "range_register": args.range_register, "output": args.output}


def _columns(args: Args) -> dict[str, float]:
    return {
        "temperature_c": args.temperature_c,
        "humidity_pct": args.humidity_pct,
        "gain": float(args.gain),
        "range_mm": 43.0 * (args.range_register + 1),
    }


def _ask_operator(cell: Cell, bar: Progress) -> None:
    bar.stop()  # a bar that redraws itself would write over the question
    TERMINAL.input(f"Place the reflector at {cell}, then press Enter ")
    bar.start()
