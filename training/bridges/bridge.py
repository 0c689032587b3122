"""Bridges to OpenDLV sessions, ROS bags and nodes, and sensors of Webots (docs/how-to/opendlv.md)."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from threadpoolctl import threadpool_limits

from acquisition import Recording, SettingError
from acquisition.io.logs.bags import TimeSeries, read_table
from acquisition.io.logs.foreign import parse_constants
from acquisition.io.places import OutputFile, OutputFolder
from acquisition.limits import Limit, Seed, Share
from noise import save_model
from sonar_gym.bridges.opendlv.agent import AgentOptions, SessionAgent
from sonar_gym.bridges.opendlv.car import CarOptions, Controls, SessionCar
from sonar_gym.bridges.opendlv.rec import Geometry, first_stamp, recording_of, write_rec
from sonar_gym.bridges.opendlv.session import Session
from sonar_gym.bridges.opendlv.sonar import KIWI, HeardWalls, SensorSettings, SonarService
from sonar_gym.bridges.opendlv.walls import load_map
from sonar_gym.bridges.ros.bag import write_bag
from sonar_gym.bridges.ros.node import NodeSettings, run_node
from sonar_gym.bridges.simulators.webots import load_tables
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.sensing.mounts import Mount, layout

KIWI_NAME = "kiwi"


@dataclass(frozen=True)
class OpendlvSonar:
    """This project's sonars on a car of an OpenDLV session: Frame in, DistanceReading out."""

    map: Path
    """Map file of the simulation: one wall a line, x1,y1,x2,y2; in m."""
    cid: Annotated[int, Limit(1, 254)] = 111
    """Number of the session."""
    model: Path = Path("srf08-mlp")
    """Sonar: a name or the folder of a saved model."""
    mounts: str = KIWI_NAME
    """Sonars on the car: kiwi (senderStamp 0 front, 1 left, 2 rear, 3 right), eight, four, ..."""
    frame_id: Annotated[int, Limit(0, 2**32 - 1)] = 0
    """senderStamp of the car's Frame."""
    frequency_hz: Annotated[float, Limit(0.1, 1000.0, "Hz")] = 10.0
    """Pings of each sonar per second."""
    latency_s: Annotated[float, Limit(0.0, 10.0, "s")] = 0.07
    """Time from a ping to its publication, s."""
    max_range: Annotated[float, Limit(0.05, 100.0, "m")] = 6.0
    """Greatest range, m."""
    reflectance: Share = 0.9
    """Of the walls, 0 to 1."""
    seed: Seed = 0
    """Seed of the readings."""
    duration_s: Annotated[float, Limit(0.0, 1e9, "s")] = 1e9
    """Time to run, s."""
    ttl: Annotated[int, Limit(0, 255)] = 0
    """Networks that a datagram may cross; 0 stays on this machine."""


@dataclass(frozen=True)
class OpendlvCar:
    """The parking car in an OpenDLV session: requests in, readings, KinematicState and Frame out."""

    cid: Annotated[int, Limit(1, 254)] = 111
    """Number of the session."""
    model: Path = Path("srf08-mlp")
    """Sonar of the car."""
    difficulty: str = "normal"
    """Street: easy, normal or hard."""
    seed: Seed = 0
    """Seed of the street and the readings."""
    frame_id: Annotated[int, Limit(0, 2**32 - 1)] = 0
    """senderStamp of Frame and KinematicState."""
    request_id: Annotated[int, Limit(0, 2**32 - 1)] = 0
    """senderStamp of the requests to obey."""
    lock_step: bool = False
    """Drive 0.1 s for each pedal request, in place of real time."""
    ttl: Annotated[int, Limit(0, 255)] = 0
    """Networks that a datagram may cross; 0 stays on this machine."""


@dataclass(frozen=True)
class OpendlvAgent:
    """The trained parking agent at the wheel of a car in an OpenDLV session."""

    cid: Annotated[int, Limit(1, 254)] = 111
    """Number of the session."""
    frame_id: Annotated[int, Limit(0, 2**32 - 1)] = 0
    """senderStamp of the car's Frame and KinematicState."""
    request_id: Annotated[int, Limit(0, 2**32 - 1)] = 0
    """senderStamp of the requests."""
    model: str = "srf08-mlp"
    """Sonar model by which the credence of the readings is computed."""
    max_steering_deg: Annotated[float, Limit(1.0, 89.0, "deg")] = 30.0
    """Steering angle of the car at full lock, deg; about 17 for the Kiwi car."""
    max_speed: Annotated[float, Limit(0.01, 100.0, "m per s")] = 0.5
    """Speed of the car at full pedal, m/s."""
    wheelbase: Annotated[float, Limit(0.01, 10.0, "m")] = 0.26
    """Distance between the axles of the car, m."""
    duration_s: Annotated[float, Limit(0.0, 1e9, "s")] = 1e9
    """Time to run, s."""
    ttl: Annotated[int, Limit(0, 255)] = 0
    """Networks that a datagram may cross; 0 stays on this machine."""


@dataclass(frozen=True)
class OpendlvRec:
    """A .rec file of OpenDLV into a recording, or a recording (CSV) into a .rec file."""

    source: Annotated[Path, tyro.conf.Positional]
    """File to read: .rec, or the CSV of a recording."""
    out: OutputFile
    """File to write: the CSV of a recording, or .rec."""
    map: Path | None = None
    """Map file, from which the true distances follow with the Frames of the car."""
    mounts: str = KIWI_NAME
    """Sonars on the car, with map."""
    frame_id: Annotated[int, Limit(0, 2**32 - 1)] = 0
    """senderStamp of the car's Frame, with map."""
    truth_csv: Path | None = None
    """CSV with time_s (since the first envelope) or stamp_s, and distance_m."""
    constants: tuple[str, ...] = ()
    """Columns with one value in every row: name=value, for example distance_mm=1000."""
    period_s: Annotated[float, Limit(0.0, 3600.0, "s")] = 0.0
    """Time between two pings of a sensor, s: missing readings are then recorded as no echo. 0: they are left out."""
    start_s: Annotated[float, Limit(0.0, 1e11, "s")] | None = None
    """Recording into .rec: time of its beginning, s since 1970; by default now."""


@dataclass(frozen=True)
class Webots:
    """The distance sensors of a Webots world or PROTO file as models, one folder each."""

    source: Annotated[Path, tyro.conf.Positional]
    """.wbt or .proto file."""
    out: OutputFolder
    """Folder for the models."""
    metres_per_unit: Annotated[float, Limit(1e-9, 1e6, "m")] | None = None
    """Of the values that the sensors return, m; by default, the tables are inverted."""


@dataclass(frozen=True)
class RosBag:
    """A recording as a ROS 2 bag: sensor_msgs/Range, and credence in diagnostic_msgs/DiagnosticArray."""

    source: Annotated[Path, tyro.conf.Positional]
    """CSV of a recording."""
    out: OutputFolder
    """Folder of the bag."""
    model: Path | None = None
    """Sonar model by which the credence of the readings is computed; none by default."""
    sqlite: bool = False
    """Write SQLite (.db3), in place of MCAP."""
    max_range: Annotated[float, Limit(0.05, 100.0, "m")] = 6.0
    """max_range of the messages, m."""


@dataclass(frozen=True)
class RosNode:
    """A node that hears ideal ranges of a simulator; needs rclpy."""

    topics: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Topics of ideal ranges: sensor_msgs/Range, or NAME:LaserScan for sectors of a scan."""
    model: Path = Path("srf08-mlp")
    """Sonar: a name or the folder of a saved model."""
    max_range: Annotated[float, Limit(0.05, 100.0, "m")] = 6.0
    """Greatest range, m."""
    reflectance: Share = 0.5
    """Of what is seen, 0 to 1."""
    sectors: Annotated[int, Limit(1, 360)] = 8
    """Sectors of a LaserScan, each one sonar."""
    seed: Seed = 0
    """Seed of the readings."""


def _named(kind: type, name: str) -> Any:
    return Annotated[kind, tyro.conf.subcommand(name=name)]


Args = (
    _named(OpendlvSonar, "opendlv-sonar")
    | _named(OpendlvCar, "opendlv-car")
    | _named(OpendlvAgent, "opendlv-agent")
    | _named(OpendlvRec, "opendlv-rec")
    | _named(Webots, "webots")
    | _named(RosBag, "ros-bag")
    | _named(RosNode, "ros-node")
)


def main(args: Any) -> None:
    """Run one bridge."""
    with threadpool_limits(1):  # a few sonars are too few for several threads, which wait for each other
        BRIDGES[type(args)](args)


def _mounts(name: str) -> tuple[Mount, ...]:
    return KIWI if name == KIWI_NAME else layout(name)


def _sonar(args: OpendlvSonar) -> None:
    mounts = _mounts(args.mounts)
    settings = SensorSettings(
        args.frame_id, args.frequency_hz, args.latency_s, args.max_range, seed=args.seed
    )  # fmt: skip
    heard = HeardWalls(load_map(args.map, args.reflectance), args.model, mounts, settings)
    phases = np.array([mount.phase_s for mount in mounts])
    with Session.join(args.cid, args.ttl) as session:
        service = SonarService(session, heard, phases)
        print(f"session {args.cid}: {len(mounts)} sonars at {args.frequency_hz:g} Hz; stop with Ctrl-C", flush=True)
        gc.freeze()  # what the start has made stays, so that no search for garbage in it delays a sonar
        service.run(args.duration_s)
    print(f"published {service.published} readings")


def _car(args: OpendlvCar) -> None:
    env = SonarParkingEnv(sonar=args.model, difficulty=args.difficulty)
    options = CarOptions(args.frame_id, args.request_id, args.lock_step)
    with Session.join(args.cid, args.ttl) as session:
        print(f"session {args.cid}: car {args.frame_id}, {'lock step' if args.lock_step else 'real time'}", flush=True)
        outcome = SessionCar(session, env, options).drive(args.seed)
    ends = {"parked": outcome.parked, "collision": outcome.collision, "left the street": outcome.left_street}
    how = next((name for name, happened in ends.items() if happened), "not parked")
    print(f"{how} after {outcome.steps} steps of 0.1 s")


def _agent(args: OpendlvAgent) -> None:
    with Session.join(args.cid, args.ttl) as session:
        controls = Controls(
            max_steering=float(np.radians(args.max_steering_deg)), max_speed=args.max_speed, wheelbase=args.wheelbase
        )
        options = AgentOptions(args.frame_id, args.request_id, sonar=args.model, controls=controls)
        agent = SessionAgent(session, options=options)
        print(f"session {args.cid}: agent drives car {args.frame_id}; stop with Ctrl-C", flush=True)
        agent.run(args.duration_s)


def _rec(args: OpendlvRec) -> None:
    if args.out.suffix == ".rec":
        start = time.time() if args.start_s is None else args.start_s
        written = write_rec(Recording.load(args.source), args.out, start)
        print(f"{args.out}: {written} readings; pings without an echo leave nothing")
        return
    if args.map is not None and args.truth_csv is not None:
        raise SettingError("give --map or --truth-csv, not both")
    constants = parse_constants(args.constants)
    recording = recording_of(args.source, _truth(args), args.period_s, constants=constants)
    recording.save(args.out)
    print(f"{args.out}: {len(recording)} pings, {int((~recording.reading.echo).sum())} without echo")


def _truth(args: OpendlvRec) -> Geometry | TimeSeries | None:
    if args.map is not None:
        return Geometry(load_map(args.map), _mounts(args.mounts), args.frame_id)
    return None if args.truth_csv is None else read_table(args.truth_csv, first_stamp(args.source))


def _webots(args: Webots) -> None:
    for name, model in load_tables(args.source, args.metres_per_unit).items():
        folder = args.out / "".join(c if c.isalnum() or c in "-_" else "-" for c in name)
        print(f"{save_model(model, folder)}: {len(model.distances)} rows, up to {model.max_range:g} m")


def _bag(args: RosBag) -> None:
    written = write_bag(Recording.load(args.source), args.out, args.model, args.max_range, args.sqlite)
    print(f"{args.out}: {written} messages of sensor_msgs/Range")


def _node(args: RosNode) -> None:
    run_node(args.topics, NodeSettings(args.model, args.max_range, args.reflectance, args.sectors, args.seed))


BRIDGES: dict[type, Callable[[Any], None]] = {
    OpendlvSonar: _sonar,
    OpendlvCar: _car,
    OpendlvAgent: _agent,
    OpendlvRec: _rec,
    Webots: _webots,
    RosBag: _bag,
    RosNode: _node,
}
