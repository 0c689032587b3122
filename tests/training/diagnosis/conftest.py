"""Diagnoses made from physical models, one for each situation that a report must be able to show."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise.discrepancy.report.words import summary_of
from noise.discrepancy.result import (
    Alternative,
    Aspect,
    BaselineCheck,
    Cause,
    Diagnosis,
    HeldOut,
    Interval,
    Kind,
    Location,
    Measurement,
    PValue,
    Score,
    Unexplained,
    Verdict,
    Visible,
)
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.metrics import crps
from noise.model import IdealModel, simulate
from noise.physical import PhysicalModel

INF = float("inf")
SURE, CHANCE = PValue(1 / 2001, 2000, 612, 9), PValue(0.34, 2000, 612, 9)
BASE = {
    "sensitivity": {"loss_db": 42.0},
    "beam_width": {"ka": 4.8},
    "travel_time_jitter": {"sigma_m": 0.003, "per_metre": 0.001},
}
NEXT = Measurement(
    "Repeat five distances in air at least 10 °C warmer or colder",
    ("sound_speed", "clock_scale"),
    60,
    {"distance": (0.5, 1.0, 2.0)},
)
VISIBLE = (
    Visible("zero_offset", 0.0012, "m"),
    Visible("dropped_reading", 0.011, "1"),
    Visible("sound_speed", 1.1, "degC"),
    Visible("bias", 0.0011, "m"),
    Visible("detection", 0.02, "1"),
)


def physical(**effects):
    """Return a physical model: the base with changed or further effects."""
    return PhysicalModel([CATALOGUE[name](**values) for name, values in {**BASE, **effects}.items()])


def interval(value, low, high, unit="1"):
    return Interval(value, low, high, unit)


def share(value, spread=0.03):
    return Interval(value, max(0.0, value - spread), min(1.0, value + spread), "1")


def cause(model, effect, probability=0.97, alternatives=(), part=0.94, gain=412.0, statement=None):
    """Return a cause with the parameters that a model has."""
    found = next(each for each in model.effects if each.name == effect)
    known = {
        p.name: interval(v := found.values[p.name], v - 0.03 * abs(v), v + 0.03 * abs(v), p.unit)
        for p in found.parameters
        if found.values[p.name] != p.null
    }
    named = tuple(Alternative(name, weight) for name, weight in alternatives)
    text = statement or found.statement()
    return Cause(effect, probability, named, share(part), gain, 0.06 * gain, known, text)


def survey(rng, visits=150, each=12, angles=(0.0, 9.0, 18.0, 27.0), low=0.25, high=3.0):
    """Return pings of a survey in random order of positions, in four sessions."""
    distance, angle = rng.uniform(low, high, visits), np.deg2rad(rng.choice(angles, visits))
    n = visits * each
    warm = 20.0 + 3.0 * np.sin(np.arange(n) / n * 6.0)
    run = np.arange(n) * 4 // n
    pings = Ping.of(
        np.repeat(distance, each), np.repeat(angle, each), incidence=0.0, time=np.arange(n) * 0.5, temperature_c=warm
    )
    return pings if visits < 8 else Ping(**{**vars(pings), "run": run})


def held_out(batch, unseen, before, emulator, after):
    """Return scores on the unseen visits; silence is left out of the error here."""
    test = batch.select(unseen)

    def score(model):
        law = model.law(test.ping, test.past)
        error = np.nanmean(crps(law, test.reading)) if test.reading.echo.any() else float("nan")
        return Score(float(np.mean(np.maximum(law.log_prob(test.reading), -30.0))), float(error))

    one, two, three = score(before), score(emulator), score(after or before)
    gain = three.log_likelihood_per_ping - one.log_likelihood_per_ping
    limit = 0.95 * three.crps_m if after else three.crps_m
    return HeldOut(len(test), test.n_visits, one, two, three, limit, interval(gain, 0.9 * gain, 1.1 * gain))


def diagnosis(truth, pings, kind, before=None, after=None, causes=(), where=(), rest=0.04, more=(), seed=0, **verdict):
    """Return a diagnosis of readings that `truth`, a model or a function of pings, gives at the pings."""
    rng, before = np.random.default_rng(seed), before or physical()
    reading = truth(pings, rng) if callable(truth) else simulate(truth, pings, rng)
    batch = Batch.of(Recording.of(pings, reading, "recorded.csv"))
    unseen = batch.visit % 4 == 0 if batch.n_visits > 3 else np.ones(len(batch), bool)
    unexplained = Unexplained(share(rest), SURE if more else CHANCE, tuple(more), verdict.pop("description", None))
    visible = verdict.pop("visible", VISIBLE)
    made = Verdict(
        kind,
        summary_of(kind, causes, where, unexplained, visible, len(batch)),
        SURE if where or more else CHANCE,
        tuple(where),
        tuple(causes),
        unexplained,
        visible,
        held_out(batch, unseen, before, before, after),
        verdict.pop("ahead", ()),
        BaselineCheck(True, CHANCE, 0.94, "the emulator describes the simulation: p = 0.34"),
        verdict.pop("warnings", ()),
    )
    return Diagnosis(made, batch, None, unseen, before, before, after, after, "recorded.csv", 0)


def none():
    return diagnosis(physical(), survey(np.random.default_rng(1)), Kind.NONE, rest=0.0)


def trifle():
    truth = physical(zero_offset={"offset_m": 0.001})
    found = Location(Aspect.BIAS, {"distance": (1.5, 3.0)}, interval(0.001, 0.0008, 0.0012, "m"), SURE)
    return diagnosis(truth, survey(np.random.default_rng(10)), Kind.NONE, rest=0.0, more=[found])


def scale():
    after = physical(sound_speed={"temperature_c": 14.05})
    found = Location(Aspect.BIAS, {"distance": (1.5, 3.0)}, interval(0.033, 0.031, 0.035, "m"), SURE)
    one = cause(after, "sound_speed", 0.62, [("clock_scale", 0.27), ("thermal_drift", 0.11)])
    pings = survey(np.random.default_rng(2))
    return diagnosis(after, pings, Kind.EXPLAINED, None, after, [one], [found], ahead=(NEXT,))


def clutter():
    after = physical(fixed_clutter={"presence": 0.08, "range_m": 0.7, "spread_m": 0.004})
    found = Location(Aspect.EARLY, {"distance": (0.75, 3.0)}, interval(0.08, 0.071, 0.089), SURE)
    causes = [cause(after, "fixed_clutter", 0.98, part=0.97)]
    return diagnosis(after, survey(np.random.default_rng(3)), Kind.EXPLAINED, None, after, causes, [found])


def dropped():
    after = physical(dropped_reading={"probability": 0.12})
    found = Location(Aspect.DETECTION, {}, interval(-0.118, -0.13, -0.106), SURE)
    causes = [cause(after, "dropped_reading", 0.96, [("stuck", 0.02)], part=0.95)]
    ahead = Measurement("Ping one target at 1 m for five minutes", ("dropped_reading", "stuck"), 300)
    return diagnosis(
        after, survey(np.random.default_rng(4)), Kind.EXPLAINED, None, after, causes, [found], ahead=(ahead,)
    )


def unexplained():
    def truth(pings, rng):
        drawn = simulate(physical(), pings, rng)
        wave = 0.02 * np.sin(np.rad2deg(pings.angle)) * pings.distance
        return Reading.of(np.where(drawn.echo, np.maximum(np.round(drawn.range + wave, 3), 0.001), 0.0))

    found = Location(Aspect.BIAS, {"angle": (0.1, 0.25)}, interval(0.014, 0.011, 0.017, "m"), SURE)
    rest = Location(Aspect.BIAS, {"angle": (0.1, 0.25), "distance": (1.5, 3.0)}, found.size, SURE)
    text = "reading - prediction = 20 mm × sin(angle) × distance, stable in 94 % of resamples"
    pings = survey(np.random.default_rng(5), angles=range(0, 30, 2))
    return diagnosis(truth, pings, Kind.UNEXPLAINED, where=[found], rest=0.97, more=[rest], description=text)


def partly():
    after = physical(zero_offset={"offset_m": 0.018}, spike={"probability": 0.03})
    truth = physical(
        zero_offset={"offset_m": 0.018},
        spike={"probability": 0.03},
        thermal_drift={"rate_k_per_h": -20.0, "sine_k": 10.0, "period_s": 500.0},
    )
    where = [
        Location(Aspect.BIAS, {}, interval(0.018, 0.016, 0.02, "m"), SURE),
        Location(Aspect.LATE, {}, interval(0.028, 0.022, 0.033), SURE),
    ]
    rest = Location(Aspect.BIAS, {"time": (400.0, 800.0)}, interval(0.006, 0.004, 0.008, "m"), SURE)
    causes = [
        cause(after, "zero_offset", 0.99, part=0.55),
        cause(after, "spike", 0.9, [("false_alarm", 0.08)], part=0.21, gain=90.0),
    ]
    pings = survey(np.random.default_rng(6))
    return diagnosis(truth, pings, Kind.PARTLY_EXPLAINED, None, after, causes, where, 0.24, [rest])


def too_little():
    rng = np.random.default_rng(7)
    visible = (Visible("zero_offset", 0.061, "m"), Visible("dropped_reading", 0.55, "1"))
    warnings = ("Only 2 positions were recorded: at least 20 are needed to locate a difference.",)
    return diagnosis(
        physical(),
        survey(rng, 2, 4),
        Kind.TOO_LITTLE_DATA,
        visible=visible,
        warnings=warnings,
        rest=0.0,
    )


def drift():
    after = physical(warm_up={"offset_m": 0.02, "tau_s": 900.0})
    n = 1500
    pings = Ping.of(np.full(n, 1.2), time=np.arange(n) * 3.0)
    found = Location(Aspect.BIAS, {"time": (0.0, 1200.0)}, interval(0.013, 0.012, 0.014, "m"), SURE)
    causes = [cause(after, "warm_up", 0.7, [("thermal_drift", 0.28)])]
    return diagnosis(after, pings, Kind.EXPLAINED, None, after, causes, [found])


def silent():
    rng = np.random.default_rng(8)
    found = Location(Aspect.DETECTION, {}, interval(-0.99, -1.0, -0.97), SURE)
    after = physical(sensitivity={"loss_db": 80.0})

    def truth(pings, rng):
        return Reading.of(np.zeros(len(pings)))

    one = cause(after, "sensitivity", 0.6, [("dropped_reading", 0.4)])
    return diagnosis(truth, survey(rng, 40), Kind.EXPLAINED, None, after, [one], [found])


def robot():
    rng = np.random.default_rng(9)
    n = 2000
    distance = 1.6 + 1.1 * np.sin(np.arange(n) * 0.013)
    pings = Ping.of(distance, angle=0.25 * np.cos(np.arange(n) * 0.031), incidence=0.0, time=np.arange(n) * 0.1)
    late = Ping.of(np.interp(pings.time - 0.3, pings.time, distance), pings.angle, incidence=0.0, time=pings.time)
    found = Location(Aspect.BIAS, {"time": (60.0, 120.0)}, interval(0.009, 0.006, 0.012, "m"), SURE)
    del rng
    return diagnosis(
        lambda pings, rng: simulate(physical(), late, rng),
        pings,
        Kind.UNEXPLAINED,
        where=[found],
        rest=0.93,
        more=[found],
        before=IdealModel(),
    )


SITUATIONS = {
    made.__name__: made
    for made in (none, trifle, scale, clutter, dropped, unexplained, partly, too_little, drift, silent, robot)
}


@pytest.fixture(scope="session")
def situations():
    """Diagnoses by the name of their situation, each made once."""
    return {name: make() for name, make in SITUATIONS.items()}
