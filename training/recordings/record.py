"""Recording of a survey with a real sonar, the waveform rig, or a real driver of a simulated sonar."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from acquisition import DeviceError, EchoStatus, Ping, Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.laboratory.setup import RANGE_STEP_MM
from acquisition.drivers import DRIVERS, Srf08
from acquisition.drivers.devantech import Devantech
from acquisition.errors import SettingError
from acquisition.io.places import OutputFile
from acquisition.limits import Count, Limit, Seed
from acquisition.survey.apply_settings import apply_settings
from acquisition.survey.plan import Condition, Order, SurveyPlan
from acquisition.survey.planfile import find_plan
from acquisition.survey.session import NoOperator, Operator, Session
from acquisition.survey.sources import (
    DriverSource,
    PingSource,
    RigSource,
    Thermometer,
    check_sweep,
    register_writer,
)
from acquisition.twins.devantech import BadWire, Srf08Twin
from training.common.progress import TERMINAL, bars
from training.recordings.live import visit_line
from training.recordings.operator import TerminalOperator

AIR = {"temperature_c": 19.0, "humidity_pct": 50.0}  # of the rig and the twin
REPLACE = "delete the file or give another"
MAX_UNANSWERED = 0.05  # share of pings without an answer above which a warning is printed


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym record`.

    Example:
        sonar-gym record --driver rig --plan quick --out rec.csv --seed 1 --unit 7
    """

    out: OutputFile
    """Recording to write; each condition is written as soon as it is measured."""
    driver: Literal["rig", "twin", "srf08", "srf10", "srf02", "hcsr04", "maxbotix", "maxbotix-pwm"] = "rig"
    """rig: simulated waveforms. twin: SRF08 driver with a simulated SRF08. Others: real sensors at `port`."""
    plan: str = "quick"
    """quick (3,600 pings), turned, thesis (133,100 pings), crosstalk, loose, vertical, gain-sweep, or FILE.toml."""
    order: Order | None = None
    """random: separates drift from distance. walk: few moves by hand. grid: in order. Default: as in the plan."""
    live: bool = False
    """Draw the readings of each condition as soon as it is measured."""
    resume: bool = False
    """Resume an interrupted recording; plan, seed and settings must be unchanged."""
    seed: Seed | None = None
    """Seed of the order of conditions and of the rig. Default: as in the plan."""
    pings: Annotated[int, Limit(1, 1_000_000)] | None = None
    """Pings per condition. Default: as in the plan."""
    interval_s: Annotated[float, Limit(0.0, 3600.0, "s")] | None = None
    """Seconds between pings. Default: as in the plan."""
    pose: Literal["plan", "facing", "parallel"] = "plan"
    """Orientation of a reflector off the axis: facing the sensor, parallel to its face, or as in the plan."""
    gain: Annotated[int, Limit(0, 31)] | None = None
    """Maximum amplifier gain, code 0..31. Default: full, as a sensor has it after power-up (31; SRF10: 16)."""
    range_register: Annotated[int, Limit(0, 255)] = 140
    """0..255; the range limit is 43 mm * (value + 1)."""
    output: Literal["cm", "inch", "us"] = "cm"
    """Unit of the sensor's readings."""
    echoes: Annotated[int, Limit(1, 17)] = 4
    """Echoes per ping to record, 1..17."""
    sensor: str = "0"
    """Name of the sensor in the recording."""
    unit: Seed = 0
    """rig, twin: serial number of the simulated sensor; 0 is the nominal sensor."""
    temperature_c: Annotated[float, Limit(-40.0, 85.0, "degC")] | None = None
    """Air temperature, degC: of rig and twin, by default 19; or measured beside the real sensor, logged where given."""
    humidity_pct: Annotated[float, Limit(0.0, 100.0, "%")] | None = None
    """Relative humidity, %, likewise; of rig and twin, by default 50."""
    thermometer: Path | None = None
    """Real sensors: file with the air temperature in 0.001 degC, read every ten seconds, such as
    /sys/bus/w1/devices/28-*/temperature of a DS18B20; replaces `temperature_c`."""
    operator: Literal["ask", "none"] = "ask"
    """Real sensors: ask an operator to move the reflector, or continue without questions."""
    patience: Count = 10
    """Real sensors: consecutive pings without an answer after which the connection is considered lost."""
    port: str | None = None
    """Real sensors: /dev/i2c-N of this machine, or the serial port of an Arduino with the sketch (srf*: either; hcsr04,
    maxbotix-pwm: the Arduino) or of a MaxBotix. Defaults: /dev/i2c-1, /dev/ttyACM0, /dev/ttyUSB0."""
    address: Annotated[int, Limit(0x70, 0x7F)] = 0x70
    """srf*: 7-bit address, 112..127."""
    trigger: Annotated[int, Limit(2, 69)] = 9
    """hcsr04: trigger pin of the Arduino."""
    echo: Annotated[int, Limit(2, 69)] = 8
    """hcsr04, maxbotix-pwm: echo (PW) pin of the Arduino."""
    model: Literal["lv", "xl", "xl-long", "hrlv", "hrxl", "hrxl-long"] = "hrlv"
    """maxbotix*: model family, which determines unit, digits and the value for no echo."""


def main(args: Args) -> None:
    """Record a survey with a progress bar, and print a summary."""
    args = with_gain(args)
    plan = plan_of(args)
    source = SOURCES[args.driver](args)
    if not source.simulated:
        TERMINAL.print(effort(plan), highlight=False)
    with bars() as bar:
        operator: Operator = (
            NoOperator() if source.simulated or args.operator == "none" else TerminalOperator(TERMINAL, bar)
        )
        settings: dict[str, Any] = {"settings": session_settings(args)}
        if args.live:
            settings["watch"] = lambda condition, measured: TERMINAL.out(visit_line(condition, measured))
        session = Session(plan, source, args.out, args.resume, args.echoes, args.sensor, operator, **settings)
        task = bar.add_task(args.out.name, total=len(plan) * plan.pings, visible=False)
        measure(session, lambda done, total: bar.update(task, completed=done, total=total, visible=True))
    print(summary(args.out, plan))


def measure(session: Session, progress: Callable[[int, int], None]) -> None:
    """Run a session; on an error or interruption, report how much is on disk and how to resume."""
    try:
        session.run(progress)
    except DeviceError as error:
        raise type(error)(f"{error}; {_on_disk(session)}") from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"{session.path}: {_on_disk(session)}") from None


def _on_disk(session: Session) -> str:
    """Return how much is on disk and how to resume."""
    try:
        conditions = len(Recording.load(session.path)) // session.plan.pings
    except (ValueError, OSError):
        conditions = 0
    advice = REPLACE if session.settings.get("driver") == "twin" else "continue with --resume"
    return f"{conditions} of {len(session.plan)} conditions are on disk; {advice}"


def effort(plan: SurveyPlan) -> str:
    """Return a line on the work of a plan for an operator who moves the reflector by hand."""
    walk, hours = replace(plan, order="walk"), plan.seconds / 3600.0
    hint = f" (--order walk: {walk.travel_m:.0f} m)" if walk.travel_m < 0.8 * plan.travel_m else ""
    size = f"{len(plan)} conditions, {len(plan) * plan.pings} pings, about {hours:.1f} h"
    return f"{size}; {plan.moves} moves by hand over {plan.travel_m:.0f} m{hint}"


def plan_of(args: Args) -> SurveyPlan:
    """Return the plan with the changes that the settings request."""
    plan = find_plan(args.plan)
    names = ("pings", "interval_s", "order", "seed")
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if args.pose != "plan":
        given |= {"facing": args.pose == "facing", "incidences_deg": ()}
    return replace(plan, **given)


def session_settings(args: Args) -> dict[str, Any]:
    """Return the settings that must be unchanged when a session is resumed."""
    if args.driver in SETTINGS:
        return {name: getattr(args, name) for name in ("driver", *SETTINGS[args.driver], "port")}
    return {"driver": args.driver, "unit": args.unit, **_registers(args), **_air(args)}


def summary(path: Path, plan: SurveyPlan) -> str:
    """Return one line on the recording, and warnings."""
    if not path.stat().st_size:
        return f"{path}: nothing was recorded; continue with --resume"
    recording = Recording.load(path)
    status = recording.reading.status
    shares = [100.0 * float(np.mean(status == kind)) for kind in (EchoStatus.ECHO, EchoStatus.NO_ECHO)]
    unanswered, conditions = int((status == EchoStatus.NO_ANSWER).sum()), len(recording) // plan.pings
    lines = [
        f"{path}: {len(recording)} pings on {conditions} conditions; "
        f"{shares[0]:.1f} % with echo, {shares[1]:.1f} % without echo, {unanswered} without answer"
    ]
    if unanswered > MAX_UNANSWERED * len(recording):
        lines.append(f"{100 * unanswered / len(recording):.0f} % of pings had no answer: check plugs, wires and power")
    if conditions < len(plan):
        lines.append(f"{len(plan) - conditions} of {len(plan)} conditions are not measured yet: continue with --resume")
    return "\n".join(lines)


def _rig(args: Args) -> Rig:
    setup = Setup(**_registers(args), **_air(args))
    return Rig(Unit.draw(args.unit) if args.unit else Unit.nominal(), setup)


def _air(args: Args) -> dict[str, Any]:
    """Return temperature and humidity of the simulated air."""
    return {**AIR, **_measured_air(args)}


def _measured_air(args: Args) -> dict[str, Any]:
    return {name: getattr(args, name) for name in AIR if getattr(args, name) is not None}


def _seed(args: Args) -> int:
    return plan_of(args).seed


def _rig_source(args: Args) -> PingSource:
    return RigSource(_rig(args), _seed(args))


def _twin_source(args: Args) -> PingSource:
    if args.resume:
        raise SettingError(f"--resume does not work with --driver twin, which does not save its state; {REPLACE}")
    if args.out.exists():
        raise SettingError(f"{args.out}: exists already; {REPLACE}")
    rig = _rig(args)
    twin = Srf08Twin(rig, np.random.default_rng([_seed(args), args.unit]))
    sonar = Srf08(twin, twin.address, **_registers(args), sleep=twin.clock.sleep, clock=twin.clock)

    def place(condition: Condition) -> None:
        twin.rig = apply_settings(rig, condition)
        loose = condition.values.get("loose_share", 0.0)
        twin.wire = BadWire(nack=0.8 * loose, lost_write=0.2 * loose)
        register_writer(sonar)(condition)
        bearing, incidence = np.deg2rad([condition.angle_deg, condition.incidence_deg])
        twin.place(Ping.of(condition.distance_mm * 1e-3, bearing, incidence, condition.reflectance))

    return DriverSource(
        sonar,
        place,
        _air(args) | _columns(args, sonar),
        args.patience,
        sleep=twin.clock.sleep,
        clock=twin.clock,
        simulated=True,
    )


# settings of each real sensor
SETTINGS: dict[str, tuple[str, ...]] = {
    "srf08": ("address", "gain", "range_register", "output"),
    "srf10": ("address", "gain", "range_register", "output"),
    "srf02": ("address", "output"),
    "hcsr04": ("trigger", "echo"),
    "maxbotix": ("model",),
    "maxbotix-pwm": ("model", "echo"),
}


def _real_source(args: Args) -> PingSource:
    given = {name: getattr(args, name) for name in SETTINGS[args.driver]}
    where = {} if args.port is None else {"port": args.port}
    sonar = DRIVERS[args.driver].open(**where, **given)
    check_sweep(sonar, plan_of(args))
    if isinstance(sonar, Devantech):
        TERMINAL.print(f"{sonar} answers, revision {sonar.revision()}")
    return DriverSource(sonar, register_writer(sonar), _columns(args, sonar), args.patience)


# driver -> source of pings
SOURCES: dict[str, Callable[[Args], PingSource]] = {
    "rig": _rig_source,
    "twin": _twin_source,
    **dict.fromkeys(SETTINGS, _real_source),
}


def with_gain(args: Args) -> Args:
    """Return the settings with the gain of the sensor after power-up where none is given."""
    full = getattr(DRIVERS.get(args.driver), "max_gain", Srf08.max_gain)
    return replace(args, gain=full) if args.gain is None else args


def _registers(args: Args) -> dict[str, Any]:
    return {"gain": args.gain, "range_register": args.range_register, "output": args.output}


def _columns(args: Args, sonar: Any) -> dict[str, float | Callable[[], float]]:
    """Return the logged columns: temperature and humidity where they are measured, and the sensor's registers."""
    columns: dict[str, float | Callable[[], float]] = {**_measured_air(args)}
    if args.thermometer:
        columns["temperature_c"] = Thermometer(args.thermometer)
    if hasattr(sonar, "range_register"):
        columns |= {"gain": lambda: float(sonar.gain), "range_mm": lambda: RANGE_STEP_MM * (sonar.range_register + 1)}
    return columns
