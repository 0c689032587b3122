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

import numpy as np

from acquisition import Recording
from acquisition.arrays import Bits, Floats
from noise.law import CREDENCE_TOLERANCE, ExtrapolationWarning
from noise.metrics import ClusterMean
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
    off = np.abs(reading.range - ping.distance)
    right = (reading.echo & (off <= CREDENCE_TOLERANCE * ping.distance + 1e-9))[answered]
    credence, sensor = law.credence()[answered], recording.table["sensor"].to_numpy()[answered]
    means = ClusterMean.of(right, sensor), ClusterMean.of(credence - right, sensor)
    return Calibration(*means, calibration_error(credence, right), float(law.extrapolates.mean()))


def calibration_error(credence: Floats, right: Bits) -> float:
    """Return the mean over tenths of credence, weighted by pings, of the gap between credence and frequency.

    >>> round(calibration_error(np.array([0.05, 0.05, 0.95, 0.95]), np.array([False, False, True, False])), 3)
    0.25
    """
    tenth = np.minimum((10.0 * credence).astype(int), 9)
    return float(np.abs(np.bincount(tenth, credence - right)).sum() / len(right))
