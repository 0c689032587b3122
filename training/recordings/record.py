"""Record a survey: with a real sonar, with the waveform rig, or with a real driver over a simulated sonar."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from acquisition import DeviceError, EchoStatus, Ping, Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.drivers import DRIVERS, Srf08
from acquisition.drivers.devantech import Devantech
from acquisition.errors import SettingError
from acquisition.survey.apply_settings import arranged
from acquisition.survey.plan import Cell, Order, Plan
from acquisition.survey.planfile import find_plan
from acquisition.survey.session import Nobody, Operator, Session
from acquisition.survey.sources import DriverSource, RigSource, Source, Thermometer, told
from acquisition.twins.devantech import BadWire, Srf08Twin
from training.common.progress import TERMINAL, bars
from training.recordings.operator import Asking

MANY_LOST = 0.05  # share of pings without answer from which a wire is worth a look


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym record`.

    Example:
        sonar-gym record --driver rig --plan quick --out rec.csv --seed 1 --unit 7
    """

    out: Path
    """Recording to write; each condition is on disk as soon as it is measured."""
    driver: Literal["rig", "twin", "srf08", "srf10", "srf02", "hcsr04", "maxbotix"] = "rig"
    """rig: simulated waveforms. twin: the SRF08's driver over a simulated SRF08. The others: real sensors at `port`."""
    plan: str = "quick"
    """quick (3,600 pings), turned, thesis (133,100 pings), crosstalk, loose, vertical, gain-sweep, or FILE.toml."""
    order: Order | None = None
    """random: drift cannot pass for distance. walk: few moves by hand. grid. As the plan has it if not given."""
    resume: bool = False
    """Go on with a recording that was interrupted; plan, seed and settings must be those it was begun with."""
    seed: int | None = None
    """Of the order of conditions, and of everything random in the rig; as the plan has it if not given."""
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
    sensor: str = "0"
    """What to call the sensor in the recording."""
    unit: int = 0
    """rig, twin: serial number of the simulated sensor; 0 is the nominal one."""
    temperature_c: float = 19.0
    """Of the air, degC: the rig's own, or what a thermometer beside the real sensor shows."""
    humidity_pct: float = 50.0
    """Of the air, %."""
    thermometer: Path | None = None
    """Real sensors: file that holds the air's temperature in thousandths of a degree, read every ten seconds, such as
    /sys/bus/w1/devices/28-*/temperature of a DS18B20; instead of `temperature_c`."""
    operator: Literal["ask", "none"] = "ask"
    """Real sensors: ask somebody to move the stand, or go on unasked (nothing has to be moved by hand)."""
    patience: int = 10
    """Real sensors: pings in a row without an answer after which the wire counts as dead."""
    port: str | None = None
    """Real sensors: /dev/i2c-N of this machine, or the serial port of an Arduino with the sketch of docs/drivers.md
    (srf*: either; hcsr04: the Arduino) or of a MaxBotix; /dev/i2c-1, /dev/ttyACM0, /dev/ttyUSB0 if not given."""
    address: int = 0x70
    """srf*: 7-bit address, 112..127."""
    trigger: int = 9
    """hcsr04: pin of the Arduino."""
    echo: int = 8
    """hcsr04: pin of the Arduino."""
    model: Literal["lv", "xl", "xl-long", "hrlv", "hrxl", "hrxl-long"] = "hrlv"
    """maxbotix: family, which decides unit, digits and the value for no echo."""


def main(args: Args) -> None:
    """Record, show how far it is, and say what came of it."""
    plan = plan_of(args)
    source = SOURCES[args.driver](args)
    if not source.simulated:
        TERMINAL.print(effort(plan), highlight=False)
    with bars() as bar:
        operator: Operator = Nobody() if source.simulated or args.operator == "none" else Asking(TERMINAL, bar)
        session = Session(plan, source, args.out, args.resume, args.echoes, args.sensor, operator, kept(args))
        task = bar.add_task(args.out.name, total=len(plan) * plan.pings, visible=False)
        measure(session, lambda done, total: bar.update(task, completed=done, total=total, visible=True))
    print(summary(args.out, plan))


def measure(session: Session, progress: Callable[[int, int], None]) -> None:
    """Run a session; where it breaks off, say how much is on disk and how to go on."""
    try:
        session.run(progress)
    except DeviceError as error:
        raise type(error)(f"{error}; {_on_disk(session)}") from None
    except KeyboardInterrupt:
        print(f"sonar-gym: {session.path}: {_on_disk(session)}", file=sys.stderr)
        raise


def _on_disk(session: Session) -> str:
    """Tell how much is on disk and how to go on."""
    try:
        cells = len(Recording.load(session.path)) // session.plan.pings
    except (ValueError, OSError):
        cells = 0
    return f"{cells} of {len(session.plan)} conditions are on disk, go on with --resume"


def effort(plan: Plan) -> str:
    """Return a line on how much work a plan is for somebody who moves stands by hand."""
    walk, hours = replace(plan, order="walk"), plan.seconds / 3600.0
    hint = f" (--order walk: {walk.way_m:.0f} m)" if walk.way_m < 0.8 * plan.way_m else ""
    size = f"{len(plan)} conditions, {len(plan) * plan.pings} pings, about {hours:.1f} h"
    return f"{size}; {plan.moves} moves by hand over {plan.way_m:.0f} m{hint}"


def plan_of(args: Args) -> Plan:
    """Return the plan with what the settings change."""
    plan = find_plan(args.plan)
    names = ("pings", "interval_s", "order", "seed")
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if args.pose != "plan":
        given |= {"facing": args.pose == "facing", "incidences_deg": ()}
    return replace(plan, **given)


def kept(args: Args) -> dict[str, Any]:
    """Return the settings that a resumed session must have been begun with."""
    simulated = ("gain", "range_register", "output", "unit", "temperature_c", "humidity_pct")
    names = ["driver", *SETTINGS.get(args.driver, simulated)]
    names += ["port"] if args.driver in SETTINGS else []
    return {name: getattr(args, name) for name in names}


def summary(path: Path, plan: Plan) -> str:
    """Return a line on what was recorded, and one on what is missing or odd."""
    if not path.stat().st_size:
        return f"{path}: nothing was recorded; go on with --resume"
    recording = Recording.load(path)
    status = recording.reading.status
    shares = [100.0 * float(np.mean(status == kind)) for kind in (EchoStatus.ECHO, EchoStatus.NO_ECHO)]
    lost, cells = int((status == EchoStatus.NO_ANSWER).sum()), len(recording) // plan.pings
    lines = [
        f"{path}: {len(recording)} pings on {cells} conditions; "
        f"{shares[0]:.1f} % echoes, {shares[1]:.1f} % silent, {lost} without answer"
    ]
    if lost > MANY_LOST * len(recording):
        lines.append(f"{100 * lost / len(recording):.0f} % of pings had no answer: look at plugs, wires and power")
    if cells < len(plan):
        lines.append(f"{len(plan) - cells} of {len(plan)} conditions are still to be measured: go on with --resume")
    return "\n".join(lines)


def _rig(args: Args) -> Rig:
    setup = Setup(
        gain=args.gain,
        range_register=args.range_register,
        output=args.output,
        temperature_c=args.temperature_c,
        humidity_pct=args.humidity_pct,
    )
    return Rig(Unit.draw(args.unit) if args.unit else Unit.nominal(), setup)


def _seed(args: Args) -> int:
    return plan_of(args).seed


def _rig_source(args: Args) -> Source:
    return RigSource(_rig(args), _seed(args))


def _twin_source(args: Args) -> Source:
    if args.resume:
        raise SettingError("--resume does not go with --driver twin, which forgets its state; record it anew")
    rig = _rig(args)
    twin = Srf08Twin(rig, np.random.default_rng([_seed(args), args.unit]))
    sonar = Srf08(twin, twin.address, **_registers(args), sleep=twin.clock.sleep, clock=twin.clock)

    def place(cell: Cell) -> None:
        twin.rig = arranged(rig, cell)
        loose = cell.values.get("loose_share", 0.0)
        twin.wire = BadWire(nack=0.8 * loose, lost_write=0.2 * loose)
        told(sonar)(cell)
        bearing, incidence = np.deg2rad([cell.angle_deg, cell.incidence_deg])
        twin.place(Ping.of(cell.distance_mm * 1e-3, bearing, incidence, cell.reflectance))

    return DriverSource(
        sonar, place, _columns(args, sonar), args.patience, sleep=twin.clock.sleep, clock=twin.clock, simulated=True
    )


# which settings each real sensor has
SETTINGS: dict[str, tuple[str, ...]] = {
    "srf08": ("address", "gain", "range_register", "output"),
    "srf10": ("address", "gain", "range_register", "output"),
    "srf02": ("address", "output"),
    "hcsr04": ("trigger", "echo"),
    "maxbotix": ("model",),
}


def _real_source(args: Args) -> Source:
    given = {name: getattr(args, name) for name in SETTINGS[args.driver]}
    where = {} if args.port is None else {"port": args.port}
    sonar = DRIVERS[args.driver].open(**where, **given)
    if isinstance(sonar, Devantech):
        TERMINAL.print(f"{sonar} answers, revision {sonar.revision()}")
    return DriverSource(sonar, told(sonar), _columns(args, sonar), args.patience)


# how each kind of driver becomes something that a session measures with
SOURCES: dict[str, Callable[[Args], Source]] = {
    "rig": _rig_source,
    "twin": _twin_source,
    **dict.fromkeys(SETTINGS, _real_source),
}


def _registers(args: Args) -> dict[str, Any]:
    return {"gain": args.gain, "range_register": args.range_register, "output": args.output}


def _columns(args: Args, sonar: Any) -> dict[str, float | Callable[[], float]]:
    """Return what is logged beside each ping: the air, and what the sensor was told last."""
    columns: dict[str, float | Callable[[], float]] = {
        "temperature_c": Thermometer(args.thermometer) if args.thermometer else args.temperature_c,
        "humidity_pct": args.humidity_pct,
    }
    if hasattr(sonar, "range_register"):
        columns |= {"gain": lambda: float(sonar.gain), "range_mm": lambda: 43.0 * (sonar.range_register + 1)}
    return columns
