"""Credence of a law against the rig, at temperatures, gains and humidities beyond its training data.

New sensors meet the conditions of the corpus, which are difficult: 60 % of the readings are not within 10 % of the
distance. The gap is that between the mean credence and the observed frequency; the calibration error is the mean gap
over tenths of credence.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from acquisition import Recording
from noise.law import ExtrapolationWarning
from noise.metrics import ClusterMean, is_correct, reliability
from noise.model import SonarModel, follow
from training.noise.corpus import SCENES, Sessions, record

NEW_SENSORS = Sessions(tuple(range(900, 912)), surveys=3, drives=1, visits=40, pings=30)
# name -> air temperature, degC, and other settings of the laboratory
CONDITIONS: Mapping[str, tuple[float, Mapping[str, Any]]] = {
    **{f"{t} degC": (float(t), {}) for t in (-10, 0, 10, 20, 30, 40, 45)},
    **{f"gain {g}": (20.0, {"gain": g}) for g in (0, 7, 14, 21, 31)},
    **{f"humidity {h} %": (20.0, {"humidity_pct": float(h)}) for h in (20, 80)},
}


@dataclass(frozen=True)
class Calibration:
    """Calibration of credence under one condition.

    Attributes:
        right: frequency of readings within 10 % of the distance, over sensors.
        gap: mean credence less that frequency, over sensors.
        error: calibration error, see the module.
        extrapolates: share of pings that the law marks.
    """

    right: ClusterMean
    gap: ClusterMean
    error: float
    extrapolates: float


def recordings(
    conditions: Mapping[str, tuple[float, Mapping[str, Any]]] = CONDITIONS, sessions: Sessions = NEW_SENSORS
) -> dict[str, Recording]:
    """Return recordings of new sensors under each condition."""
    out = {}
    for k, (name, (temperature, settings)) in enumerate(conditions.items()):
        scenes = {scene: replace(setup, **settings) for scene, setup in SCENES.items()}
        there = replace(sessions, seed=100 + k, temperature_c=(temperature, temperature), scenes=scenes)
        out[name] = record(there)
    return out


def calibration(model: SonarModel, recording: Recording) -> Calibration:
    """Return the calibration of a model's credence given the conditions and, with memory, the earlier readings."""
    ping, reading, answered = recording.ping, recording.reading, recording.reading.answered
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExtrapolationWarning)
        law = follow(model, ping, reading)
    right = is_correct(ping, reading)[answered]
    credence, sensor = law.credence()[answered], recording.table["sensor"].to_numpy()[answered]
    means = ClusterMean.of(right, sensor), ClusterMean.of(credence - right, sensor)
    return Calibration(*means, reliability(credence, right, sensor).gap, float(law.extrapolates.mean()))
