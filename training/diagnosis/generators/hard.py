"""Builders of cases that are known to be hard; `HARD` holds them by name, each draws a `Trial`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from acquisition import Ping
from training.diagnosis.generators import beam, bursts, rig, ruler
from training.diagnosis.generators.ensemble import PAIR, SAME, SIMULATOR, SINGLE, make_trial, recordings_of
from training.diagnosis.generators.surveys import Design
from training.diagnosis.generators.trial import Trial, TrueCause
from training.diagnosis.generators.world import FULL_SCALE_M, Rng, Surveys, World

DESIGN = Design(100, 20, angle_deg=(-20.0, -10.0, 0.0, 10.0, 20.0), reflectance=(0.1, 0.9))


def _trial(
    family: str, simulated: World, real: World, surveys: Surveys, rng: Rng, causes: tuple[TrueCause, ...] = ()
) -> Trial:
    kind = (SAME, SINGLE, PAIR)[len(causes)]
    return Trial(family, kind, (), causes, "", *recordings_of(simulated, real, surveys, rng))


def _surveys(first: Design, second: Design, rng: Rng) -> Surveys:
    """Return surveys on two grids, and a fresh one on a third."""
    fresh = replace(second, positions=second.positions // 3)
    simulated, recorded, last = (design.survey(design.grid(rng), rng) for design in (first, second, fresh))
    return Surveys(simulated, recorded, last)


def same_elsewhere(rng: Rng) -> Trial:
    """Same sonar on other grids, in other orders, at other logged temperatures."""
    first = replace(DESIGN, order="distance", temperature_c=19.0)
    second = replace(DESIGN, order="boustrophedon", temperature_c=23.0)
    world = rig.draw_world(rng)
    return _trial("rig", world, rig.another_day(world, rng), _surveys(first, second, rng), rng)


def aliased_reflectance(rng: Rng) -> Trial:
    """Same sonar; soft targets are measured first and hard ones last, so that time stands for reflectance."""
    world, design = rig.draw_world(rng), replace(DESIGN, order="reflectance")
    return _trial("rig", world, rig.another_day(world, rng), _surveys(design, design, rng), rng)


def clutter_before_far_targets(rng: Rng) -> Trial:
    """A fixed object at 0.7 m gives 8 % of the echoes of farther targets."""
    world = beam.draw_world(rng)
    region = {"distance": (0.7, FULL_SCALE_M)}
    cause = TrueCause("fixed_clutter", ("fixed_clutter",), 1.0, "range_m", 0.7, ("early", "coincidence"), region)
    real = world.with_sonar(clutter=(0.08, 0.7))
    return _trial("beam", world, real, _surveys(DESIGN, DESIGN, rng), rng, (cause,))


def _long(error: float) -> TrueCause:
    return TrueCause("clock_scale", ("clock_scale", "sound_speed"), 1.0, "error", error, ("bias",))


def long_by_one_and_a_half_percent(rng: Rng) -> Trial:
    """All readings of the recording are 1.5 % longer."""
    world = rig.draw_world(rng)
    unit = world.sonar.unit
    real = replace(world, sonar=world.sonar.with_unit(clock_error=(1.0 + unit.clock_error) * 1.015 - 1.0))
    return _trial("rig", world, real, _surveys(DESIGN, DESIGN, rng), rng, (_long(0.015),))


def forty_pings(rng: Rng) -> Trial:
    """Same sonar, four readings at each of ten marks."""
    world = ruler.draw_world(rng)
    return _trial("ruler", world, world, ruler.surveys_at(4, rng), rng)


def ten_marks(rng: Rng) -> Trial:
    """Same sonar, 300 readings at each of ten marks."""
    world = ruler.draw_world(rng)
    return _trial("ruler", world, ruler.another_day(world, rng), ruler.surveys_at(300, rng), rng)


def fixed_target_for_weeks(rng: Rng) -> Trial:
    """A fixed target, and a sensor whose temperature compensation is missing in the recording."""
    return make_trial("fixed", SINGLE, rng, cause="sound_speed", size=1.0, pings=3000)


def robot_with_latency(rng: Rng) -> Trial:
    """The log of a driving robot whose readings are 0.3 s late."""
    return make_trial("driving", SINGLE, rng, cause="latency", size=2.0)


def nearest_of_a_cone_of_rays(rng: Rng) -> Trial:
    """A simulator that returns the nearest of a cone of rays, and the waveform rig."""
    return make_trial("rays", SIMULATOR, rng)


def _burst(wait_s: float) -> Callable[[Rng], Trial]:
    def build(rng: Rng) -> Trial:
        """Bursts in which half of the pings hear the second bounce of the ping before."""
        world = bursts.draw_world(rng).with_sonar(wait_s=wait_s, far_m=0.0, presence=0.0)
        cause = TrueCause("previous_ping", ("previous_ping",), 1.0, None, None, ("early", "memory", "bias"))
        surveys = bursts.draw_surveys(rng, 2000, {})
        return _trial("bursts", world, world.with_sonar(presence=0.5), surveys, rng, (cause,))

    return build


def _scaled(ping: Ping, factor: float, shift_m: float) -> Ping:
    return replace(ping, distance=np.round(factor * ping.distance + shift_m, 4))


def _matched(error: float, offset_m: float, cause: TrueCause) -> Callable[[Rng], Trial]:
    """Return a builder whose recording is made where its readings, pooled, are those of the simulation.

    The positions of the recording are those of the simulation, moved so that the effect cancels in mean, standard
    deviation and histogram of the readings. It shows only against the logged distance.
    """

    def build(rng: Rng) -> Trial:
        world = beam.draw_world(rng)
        real = world.with_sonar(scale=world.sonar.scale * (1.0 + error), offset_m=world.sonar.offset_m + offset_m)
        grid, fresh = DESIGN.grid(rng), replace(DESIGN, positions=DESIGN.positions // 3)
        moved = _scaled(grid, 1.0 / (1.0 + error), -offset_m)
        surveys = Surveys(DESIGN.survey(grid, rng), DESIGN.survey(moved, rng), fresh.survey(fresh.grid(rng), rng))
        return _trial("beam", world, real, surveys, rng, (cause,))

    return build


HARD: dict[str, Callable[[Rng], Trial]] = {
    "same_elsewhere": same_elsewhere,
    "aliased_reflectance": aliased_reflectance,
    "clutter_before_far_targets": clutter_before_far_targets,
    "long_by_one_and_a_half_percent": long_by_one_and_a_half_percent,
    "forty_pings": forty_pings,
    "ten_marks": ten_marks,
    "fixed_target_for_weeks": fixed_target_for_weeks,
    "robot_with_latency": robot_with_latency,
    "nearest_of_a_cone_of_rays": nearest_of_a_cone_of_rays,
    "bursts_2_ms": _burst(0.002),
    "bursts_5_ms": _burst(0.005),
    "bursts_10_ms": _burst(0.010),
    "matched_scale": _matched(0.02, 0.0, _long(0.02)),
    "matched_offset": _matched(
        0.0, 0.015, TrueCause("zero_offset", ("zero_offset",), 1.0, "offset_m", 0.015, ("bias",))
    ),
}
