"""The rig on the thesis's survey, its unknown electronics turned until it is silent where the thesis's sonar was.

Only what nobody can read off the device is turned, and only within the limits between which units are drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from acquisition import Ping, Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.laboratory.unit import RANGES
from acquisition.survey.plan import PLANS, SurveyPlan
from training.thesis.data import Floats, Samples
from training.thesis.silence import Silence

FREE = ("sensitivity_db", "radius", "yaw")  # of a unit: how loud, how wide and how askew it hears
FIRST_STEP = 0.35  # of each range
COARSE = replace(PLANS["thesis"], distances_mm=tuple(float(d) for d in range(200, 6001, 200)), pings=4)
Progress = Callable[[int, int], None]


def survey(rig: Rig, plan: SurveyPlan, seed: int, progress: Progress | None = None) -> Recording:
    """Return what a rig records on a plan that varies nothing but distance, angle and reflector."""
    parts = [plan.ping(number) for number in range(len(plan))]
    names = ("distance", "angle", "incidence", "reflectance", "time", "run")
    ping = Ping.of(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    return rig.record(ping, np.random.default_rng(seed), progress)


@dataclass(frozen=True)
class Tuned:
    """A unit whose free electronics were turned.

    Attributes:
        unit: as it came out.
        misfit: root mean square difference of where it and the thesis's sonar were silent, m, on the coarse survey.
        trials: units tried.
    """

    unit: Unit
    misfit: float
    trials: int

    @property
    def at_limit(self) -> tuple[str, ...]:
        """Names of what stands at an end of its range, so that more of it would fit better still."""
        share = (_share(self.unit)[k] for k in range(len(FREE)))
        return tuple(name for name, s in zip(FREE, share, strict=True) if min(s, 1.0 - s) < 0.01)


def tuned(
    setup: Setup,
    target: Silence,
    trials: int,
    seed: int,
    progress: Progress = lambda done, of: None,
    plan: SurveyPlan = COARSE,
) -> Tuned:
    """Turn the nominal unit's free electronics until it falls silent where `target` does (Nelder and Mead).

    Args:
        setup: the laboratory.
        target: where the thesis's sonar was silent.
        trials: surveys to spend.
        seed: of every survey, so that trials differ by the unit alone.
        progress: called after each trial.
        plan: of a trial.
    """
    tried: list[tuple[float, Unit]] = []

    def misfit(share: Floats) -> float:
        if len(tried) >= trials:
            return min(tried, key=lambda pair: pair[0])[0]
        unit = _unit(share)
        found = Silence.of_samples(Samples.of(survey(Rig(unit, setup), plan, seed)))
        tried.append((found.apart(target), unit))
        progress(len(tried), trials)
        return tried[-1][0]

    start = _share(Unit.nominal())
    corners = np.vstack([start, start + FIRST_STEP * np.eye(len(FREE)) * np.where(start > 0.5, -1.0, 1.0)])
    options: Any = {"initial_simplex": corners, "maxfev": trials, "xatol": 0.01, "fatol": 2e-3}
    minimize(misfit, start, method="Nelder-Mead", bounds=[(0.0, 1.0)] * len(FREE), options=options)
    best = min(tried, key=lambda pair: pair[0])
    return Tuned(best[1], best[0], len(tried))


def _unit(share: Floats) -> Unit:
    """Return the nominal unit with its free electronics at shares of their ranges."""
    values = {name: low + s * (high - low) for (name, low, high), s in zip(_limits(), share, strict=True)}
    return replace(Unit.nominal(), **values)


def _share(unit: Unit) -> Floats:
    return np.array([(getattr(unit, name) - low) / (high - low) for name, low, high in _limits()])


def _limits() -> list[tuple[str, float, float]]:
    return [(name, *RANGES[name]) for name in FREE]
