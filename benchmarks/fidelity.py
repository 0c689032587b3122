"""Fidelity of the sonar models along the trajectories of cars, against the waveform rig.

    python -m benchmarks.fidelity

The same cars drive the same streets; their sonars are simulated by the rig, with several units, and drawn from each
model. Every score of a model is set against the same score between one unit of the rig and the others, the best that a
law can do which does not know the unit. Prints Markdown for docs/explanation/realism.md and
writes docs/images/fidelity.png with its record.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from acquisition import Ping, Reading
from acquisition.arrays import Bits, Floats, Ints
from acquisition.bench import Rig, Setup, Unit
from acquisition.io.files import write_bytes
from noise import load_model
from noise.rig import SIMULATED, RigLaw, RigModel
from sonar_gym.agent import drive_by_agent
from sonar_gym.parking.fleet import MAX_RANGE
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sensing.detection import SHAPE, is_own_echo, nodes, own_window
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.sensing.sonar import SonarChoice
from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, panels
from training.common.commit import commit
from training.common.records import write_record

MODELS = ("ideal", "gaussian", "srf08-mlp", "srf08-lstm", "srf08-hybrid")
SIMPLE = ("ideal", "gaussian")  # hear the nearest face always
ORACLE = (
    ", faces as the rig"  # a model whose faces are chosen by the rig's detection, which shows the share of the choice
)
UNITS, STREETS, STEPS, STAND_PINGS = 40, 8, 130, 8
DETECTION_UNITS = range(50, 74)  # counted from the first one
FIRST_UNIT, SEED = 301, 2_000_000  # serial numbers that no model was trained on; streets that no agent was trained on
TEMPERATURE_C = (14.0, 26.0)  # of the survey
MOVED_M = {"1 cm": (0.005, 0.015), "5 cm": (0.04, 0.06), "20 cm": (0.17, 0.23)}
STYLES = {  # form and colour of a line
    "rig": ("-", INK),
    "ideal": ("o:", SOFT),
    "gaussian": ("s--", SOFT),
    "srf08-mlp": ("o-", AFTER),
    "srf08-lstm": ("s-", BEFORE),
    "srf08-hybrid": ("^:", INK),
}
Record = dict[str, dict[str, list[float]]]  # numbers by model
TOSS = (0.1, 0.9)  # share of echoes of identical pings within which a condition is a coin toss


@dataclass(frozen=True)
class Heard:
    """Readings along trajectories: of k draws, t observations, n cars and s sonars, each (k, t, n, s).

    Attributes:
        reading: m; the maximum range without an echo.
        echo: whether there was one.
        distance: of the face that answered, or could have, m.
        face: its number.
        in_cone: whether there is one.
        travelled: way of each car, m, (t, n).
        stood: share of echoes of identical pings of standing cars, (k, n, s).
    """

    reading: Floats
    echo: Bits
    distance: Floats
    face: Ints
    in_cone: Bits
    travelled: Floats
    stood: Floats


@dataclass(frozen=True)
class SurveyedRig(RigModel):
    """A unit of the rig whose reflectors stand as in the survey: turned towards the axis, and placed with an error.

    Attributes:
        placed: error of the reflectors' distance, bearing and orientation, the same along a drive, m, rad, rad.
    """

    placed: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def law(self, ping: Ping, past: Reading | None = None) -> RigLaw:
        """Return the law of n pings."""
        along, aside, turn = self.placed
        distance = np.maximum(ping.distance + along, 0.0)
        angle, incidence = np.abs(ping.angle) + aside, np.abs(ping.incidence) + turn
        return RigLaw(self, replace(ping, distance=distance, angle=angle, incidence=incidence))


def rig_unit(k: int) -> RigModel:
    """Return a unit of the rig in air of its own temperature, before reflectors with an error of their own."""
    rng, usual = np.random.default_rng(k), Setup()
    temperature = float(rng.uniform(*TEMPERATURE_C))
    sd = usual.placement_m, np.radians(usual.placement_deg), np.radians(usual.tilt_deg)
    along, aside, turn = (float(error) for error in rng.normal(size=3) * sd)
    rig = Rig(Unit.draw(FIRST_UNIT + k), replace(SIMULATED, temperature_c=temperature))
    return SurveyedRig(rig, k, placed=(along, aside, turn))


def make(sonar: SonarChoice) -> SonarParkingVectorEnv:
    """Return environments whose sonars do not hear each other, as the rig's units do not."""
    return SonarParkingVectorEnv(STREETS, sonar, credence_driver=None, crosstalk=False, threads=1)


def actions() -> Floats:
    """Return the actions of the shipped agent with ideal sonars, (t, n, 2)."""
    envs = make("ideal")
    act, begun, out = drive_by_agent(STREETS), np.ones(STREETS, dtype=np.bool_), []
    observation = envs.reset(seed=SEED)[0]
    for _ in range(STEPS):
        out.append(act(observation, np.flatnonzero(begun)))
        observation = envs.step(out[-1])[0]
        begun = envs.fleet.worlds.steps == 0
    return np.array(out, dtype=np.float64)


def rig_detection() -> Floats:
    """Return how often the rig detects a reflector alone, see `detection_table`: the mean of units not used otherwise.

    By it the faces that a unit of the rig hears are chosen; the draws of a few units would choose them by chance. Both
    sides are alike, so one is sampled.
    """
    one_side = np.arange(np.prod(SHAPE)).reshape(SHAPE)[:, SHAPE[1] // 2 :]
    ping = nodes(MAX_RANGE, SHAPE)[one_side.ravel()]
    readings = (rig_unit(k).law(ping).sample(np.random.default_rng(k)) for k in DETECTION_UNITS)
    heard = np.mean([is_own_echo(ping.distance, reading) for reading in readings], axis=0).reshape(one_side.shape)
    return np.concatenate([heard[:, :0:-1], heard], axis=1)


def drive(sonar: SonarChoice, course: Floats, draw: int, detection: Floats | None = None) -> tuple[Floats, ...]:
    """Return what the sonars read on one drive, and of standing cars; `draw` seeds the sonars alone."""
    envs, rows = make(sonar), []
    if detection is not None:
        envs.fleet.constants = envs.fleet.constants._replace(detection=detection)
    envs.reset(seed=SEED)
    reseed(envs, draw)
    envs.fleet.sensing.begin(np.arange(STREETS))  # new persisting errors
    car = envs.fleet.worlds.car[:, :2].copy()
    way = np.zeros(STREETS)
    for action in course:
        _, _, _, _, info = envs.step(action)
        now = envs.fleet.worlds.car[:, :2].copy()
        way, car = way + np.minimum(np.hypot(*(now - car).T), 1.0), now
        rows.append((*readings(envs), info["distance"], info["face"], info["in_cone"], way.copy()))
    stood = np.mean([readings(stand(envs, k))[1] for k in range(STAND_PINGS)], axis=0)
    return *(np.array(column) for column in zip(*rows, strict=True)), stood


def reseed(envs: SonarParkingVectorEnv, draw: int) -> None:
    """Restart the streams of the sonars."""
    for i in range(STREETS):
        envs.fleet.sonar.seed(100 * draw + i, i)


def stand(envs: SonarParkingVectorEnv, k: int) -> SonarParkingVectorEnv:
    """Ping once more where the cars stand; the first time, stop them."""
    if k == 0:
        envs.fleet.worlds.car[:, 3:] = 0.0
    envs.step(np.zeros((STREETS, 2)))
    return envs


def readings(envs: SonarParkingVectorEnv) -> tuple[Floats, Bits]:
    """Return the readings shown, m, and whether they are echoes, (n, s) each."""
    observation = envs.fleet.observation(slice(None))
    return MAX_RANGE * observation["ranges"].astype(np.float64), observation["echo"] == 1


def hear(sonars: list[SonarChoice], course: Floats, detection: Floats | None = None) -> Heard:
    """Return the readings of several draws of a model, or of several units."""
    drives = (drive(sonar, course, k, detection) for k, sonar in enumerate(sonars))
    columns = [np.array(column) for column in zip(*drives, strict=True)]
    return Heard(*columns[:5], columns[5][0], columns[6])


def crps(forecast: Floats, observed: Floats, same: bool) -> Floats:
    """Return the CRPS of an ensemble for each unit, street and sonar, m, (u, n, s): fair for its size (Ferro 2014).

    Args:
        forecast: readings of k members, (k, t, n, s).
        observed: readings of u units, (u, t, n, s).
        same: whether the members are the units, so that each is scored by the others.
    """
    between = np.array([np.abs(forecast - member).mean(axis=1) for member in forecast])  # (k, k, n, s)
    k = len(forecast) - int(same)
    scores = []
    for u, truth in enumerate(observed):
        spread = between.sum(axis=(0, 1)) - (2.0 * between[u].sum(axis=0) if same else 0.0)
        distance = between[u].sum(axis=0) if same else np.abs(forecast - truth).mean(axis=1).sum(axis=0)
        scores.append(distance / k - 0.5 * spread / (k * (k - 1)))
    return np.array(scores)


def ratio(scores: Floats, base: Floats) -> tuple[Floats, Floats]:
    """Return the ratio of mean CRPS and its standard error, jackknifed over units and over streets.

    Args:
        scores: of a model, (u, n, ...).
        base: of the rig, (u, n, ...).
    """
    variance = 0.0
    for axis in (0, 1):
        left_out = [
            np.delete(scores, i, axis).mean(axis=(0, 1)) / np.delete(base, i, axis).mean(axis=(0, 1))
            for i in range(scores.shape[axis])
        ]
        variance = variance + (scores.shape[axis] - 1) * np.var(left_out, axis=0)
    return scores.mean(axis=(0, 1)) / base.mean(axis=(0, 1)), np.sqrt(variance)


def own_errors(heard: Heard) -> Floats:
    """Return the errors of echoes of the face itself, m; NaN for others."""
    error = heard.reading - heard.distance
    own = heard.echo & heard.in_cone & (np.abs(error) <= own_window(heard.distance))
    return np.where(own, error, np.nan)


def autocorrelation(heard: Heard, low: float, high: float) -> float:
    """Return the correlation of the errors of one face, of pings with a car's way between them in a range of m."""
    error, pairs = own_errors(heard), []
    for lag in range(1, 13):
        way = np.abs(heard.travelled[lag:] - heard.travelled[:-lag])
        moved = ((way >= low) & (way <= high))[None, :, :, None] & (heard.face[:, lag:] == heard.face[:, :-lag])
        pairs.append(np.stack([error[:, :-lag][moved], error[:, lag:][moved]]))
    first, second = np.concatenate(pairs, axis=1)
    known = np.isfinite(first) & np.isfinite(second)
    return float(np.corrcoef(first[known], second[known])[0, 1]) if np.std(first[known]) > 0.0 else 1.0


def scores(heard: Heard, rig: Heard) -> dict[str, float | Floats]:
    """Return all scores of one model."""
    wrong = heard.echo & ~(heard.in_cone & (np.abs(heard.reading - heard.distance) <= 0.1 * heard.distance))
    return {
        "crps": crps(heard.reading, rig.reading, heard is rig),
        "echo": heard.echo.mean(axis=(0, 1, 2)),
        "false": wrong.mean(axis=(0, 1, 2)),
        "toss": float(np.mean((heard.stood > TOSS[0]) & (heard.stood < TOSS[1]))),
        **{name: autocorrelation(heard, *limits) for name, limits in MOVED_M.items()},
    }


def table(results: dict[str, dict[str, float | Floats]]) -> str:
    """Return the scores as Markdown."""
    names = [mount.name for mount in LAYOUTS["eight"]]
    base = results["rig"]
    lines = [
        "| model | CRPS relative to rig-versus-rig: mean | " + " | ".join(names) + " |",
        "|---|---|" + "---|" * len(names),
    ]
    for model, one in list(results.items())[1:]:
        every, reference = np.asarray(one["crps"]), np.asarray(base["crps"])
        pairs = [ratio(every.mean(axis=2), reference.mean(axis=2)), *zip(*ratio(every, reference), strict=True)]
        lines.append(f"| {model} | " + " | ".join(f"{value:.2f} ± {error:.2f}" for value, error in pairs) + " |")
    moved = " | ".join(f"autocorrelation after {name}" for name in MOVED_M)
    lines += [
        "",
        f"| model | CRPS, mm | echoes | wrong echoes | coin tosses | {moved} |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for model, one in results.items():
        rates = (f"{100.0 * np.mean(one[key]):.1f} %" for key in ("echo", "false", "toss"))
        lags = " | ".join(f"{one[name]:.2f}" for name in MOVED_M)
        lines.append(f"| {model} | {1000.0 * np.mean(one['crps']):.1f} | {' | '.join(rates)} | {lags} |")
    return "\n".join(lines)


def plain(results: dict[str, dict[str, float | Floats]]) -> Record:
    """Return what the figure shows of each model: CRPS of each sonar relative to the rig, and autocorrelations."""
    base = np.asarray(results["rig"]["crps"])
    return {
        name: {"crps": ratio(np.asarray(one["crps"]), base)[0], "lags": [one[lag] for lag in MOVED_M]}
        for name, one in results.items()
        if ORACLE not in name
    }


def figure(record: Record) -> bytes:
    """Return CRPS by sonar and autocorrelation by way, as PNG."""
    return panels([partial(_bars, record), partial(_lags, record)], (9.6, 4.0))


def _bars(record: Record, axes: Axes) -> None:
    for name, one in record.items():
        if name != "rig":
            form, colour = STYLES[name]
            axes.plot(one["crps"], form, color=colour, label=name, markersize=4)
    axes.axhline(1.0, color=INK, linewidth=1.0)
    axes.set_xticks(range(8), [mount.name for mount in LAYOUTS["eight"]], rotation=35, ha="right")
    axes.set(title="CRPS relative to the rig's own", ylim=(0.0, None))
    axes.legend()


def _lags(record: Record, axes: Axes) -> None:
    for name, one in record.items():
        form, colour = STYLES[name]
        axes.plot(one["lags"], form, color=colour, label=name, markersize=4)
    axes.set_xticks(range(len(MOVED_M)), [f"{1000.0 * np.mean(limits):.0f}" for limits in MOVED_M.values()])
    axes.set(title="Autocorrelation of errors", xlabel="way of the car (mm)", ylim=(-0.1, 1.05))
    axes.legend(loc="center left")


def main() -> None:
    """Measure, print the tables, write the record and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, default=Path("docs/images/fidelity.png"))
    parser.add_argument("--models", nargs="*", default=MODELS)
    options, made_by = parser.parse_args(), commit()
    course = actions()
    detection = rig_detection()
    rig = hear([rig_unit(k) for k in range(UNITS)], course, detection)
    results = {"rig": scores(rig, rig)}
    for name in options.models:
        draws: list[SonarChoice] = [load_model(name)] * UNITS
        results[name] = scores(hear(draws, course), rig)
        if name not in SIMPLE:
            results[f"{name}{ORACLE}"] = scores(hear(draws, course, detection), rig)
    print(table(results))
    record = write_record(options.figure, made_by, "python -m benchmarks.fidelity", plain(results))
    write_bytes(options.figure, figure(record))


if __name__ == "__main__":
    main()
