"""Credence of the shipped laws against the rig, at temperatures, gains and humidities beyond their training data.

    python -m benchmarks.conditions

New sensors meet the conditions of the corpus, which are difficult: 60 % of the readings are not within 10 % of the
distance. The gap is that between the mean credence and the observed frequency; the calibration error is the mean gap
over tenths of credence.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from acquisition import Recording
from acquisition.arrays import Bits, Floats
from noise.law import CREDENCE_TOLERANCE, ExtrapolationWarning
from noise.model import follow
from noise.store import load_model
from training.noise import corpus

UNITS = tuple(range(900, 912))
TEMPERATURES_C, GAINS, HUMIDITIES_PCT = (-10, 0, 10, 20, 30, 40, 45), (0, 7, 14, 21, 31), (20, 80)
LAWS = ("srf08-mlp", "srf08-lstm", "srf08-hybrid")


def record(temperature_c: float, seed: int, **setup: float) -> Recording:
    """Return short sessions of new sensors at one temperature, with other settings of the laboratory."""
    corpus.TEMPERATURE_C = (temperature_c, temperature_c)
    scenes = dict(corpus.SCENES)
    corpus.SCENES.update({k: replace(scene, **setup) for k, scene in scenes.items()})
    try:
        return corpus.record(corpus.Sessions(UNITS, surveys=3, drives=1, visits=40, pings=30, seed=seed))
    finally:
        corpus.SCENES.update(scenes)


def calibration_error(credence: Floats, right: Bits) -> float:
    """Return the mean over tenths of credence, weighted by pings, of the gap between credence and frequency."""
    tenth = np.minimum((10.0 * credence).astype(int), 9)
    return float(np.abs(np.bincount(tenth, credence - right)).sum() / len(right))


def rows() -> Iterator[tuple[str, Recording]]:
    """Yield the conditions by name."""
    for k, temperature in enumerate(TEMPERATURES_C):
        yield f"{temperature} degC", record(temperature, 100 + k)
    for k, gain in enumerate(GAINS):
        yield f"gain {gain}", record(20.0, 200 + k, gain=gain)
    for k, humidity in enumerate(HUMIDITIES_PCT):
        yield f"humidity {humidity} %", record(20.0, 300 + k, humidity_pct=float(humidity))


def main() -> None:
    """Print a table in Markdown."""
    warnings.simplefilter("ignore", ExtrapolationWarning)
    models = {name: load_model(name) for name in LAWS}
    print("| condition | observed |" + "".join(f" {name}: gap, calibration error |" for name in LAWS))
    print("|---|" + "---|" * (1 + len(LAWS)))
    for name, recording in rows():
        answered = recording.reading.answered
        off = np.abs(recording.reading.range - recording.ping.distance)
        right = (recording.reading.echo & (off <= CREDENCE_TOLERANCE * recording.ping.distance + 1e-9))[answered]
        cells = []
        for model in models.values():
            credence = follow(model, recording.ping, recording.reading).credence()[answered]
            cells.append(f"{credence.mean() - right.mean():+.3f}, {calibration_error(credence, right):.3f}")
        print(f"| {name} | {right.mean():.3f} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
