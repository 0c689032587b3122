"""What a diagnosis accepts as model and recording, and warnings about data that are valid but doubtful."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from acquisition import Ping, Reading, Recording, RecordingError, SettingError
from acquisition.arrays import Floats
from acquisition.io.units import doubtful_units
from noise.fitting.visits import visits_of
from noise.model import SonarModel
from noise.store import load_model

Simulator = Callable[[Ping, np.random.Generator], Reading | Floats]
Progress = Callable[[str, float], None]
MIN_CONDITIONS = 5  # as many as `name.folds` deals at a time
MIN_OVERLAP = 0.5  # share of recorded pings within the simulated conditions, below which a warning is due


def as_model(given: Any) -> SonarModel | Simulator:
    """Return a model given as such, by name or folder, or as a function (pings, rng) -> readings.

    Raises:
        UnknownModelError: neither a known name nor a folder.
        SettingError: of another type.
    """
    if isinstance(given, str | os.PathLike):
        return load_model(given)
    if not isinstance(given, type) and (callable(getattr(given, "law", None)) or _takes_pings(given)):
        checked: SonarModel | Simulator = given
        return checked
    raise SettingError(
        f"model: is a {type(given).__name__}, expected a name, a folder, a SonarModel or a function (pings, rng)"
    )


def _takes_pings(given: Any) -> bool:
    """Return whether something can be called with pings and a generator."""
    if not callable(given):
        return False
    try:
        inspect.signature(given).bind(None, None)
    except TypeError:
        return False
    except ValueError:  # a built-in function whose arguments are not known
        return True
    return True


def check_conditions(recording: Recording) -> None:
    """Check that a recording can be divided into two folds and an unseen part.

    Raises:
        RecordingError: no ping was answered, or those that were fall into fewer than `MIN_CONDITIONS` conditions; the
            log of one position is cut into series, each of which counts as a condition.
    """
    answered = recording.reading.answered
    if not answered.any():
        raise RecordingError(f"{recording.name}: no ping was answered, so there are no readings; check the wires")
    found = len(np.unique(visits_of(recording)[0][answered]))
    if found < MIN_CONDITIONS:
        raise RecordingError(
            f"{recording.name}: has answered pings under {found} different conditions (distance, angle, reflectance), "
            f"a diagnosis needs {MIN_CONDITIONS} or more; record more distances"
        )


def warnings_of(recorded: Recording, simulated: Recording | None = None) -> tuple[str, ...]:
    """Return one sentence for each doubtful property of the data; none for data without one."""
    found = [*doubtful_units(recorded), *_times(recorded), *_answers(recorded)]
    if simulated is not None:
        found += [*doubtful_units(simulated), *_times(simulated), *_overlap(recorded, simulated)]
    return tuple(found)


def _times(recording: Recording) -> Iterator[str]:
    if not recording.has("time_s"):
        return
    order = np.argsort(recording.run, kind="stable")
    step = np.diff(recording.ping.time[order])[np.diff(recording.run[order]) == 0]
    duplicated, backward = int(np.sum(step == 0)), int(np.sum(step < 0))
    if duplicated:
        yield (
            f"{recording.name}: {duplicated:,} of {len(recording):,} pings have the time stamp of the ping before; "
            "differences in time and memory may be missed."
        )
    if backward:
        yield (
            f"{recording.name}: time_s decreases within a session (rows: {backward:,}); give each session its own name "
            "in the column `session`, and sort its rows by time."
        )


def _answers(recording: Recording) -> Iterator[str]:
    lost = int(np.sum(~recording.reading.answered))
    if lost:
        yield (
            f"{recording.name}: {lost:,} of {len(recording):,} pings had no answer and were left out; "
            "check the wires and the bus."
        )


def _overlap(recorded: Recording, simulated: Recording) -> Iterator[str]:
    columns = {"distance": ("m", 1.0), "angle": ("deg", 180.0 / np.pi), "reflectance": ("", 1.0)}
    for name, (unit, factor) in columns.items():
        real, virtual = (factor * getattr(each.ping, name) for each in (recorded, simulated))
        inside = float(np.mean((real >= virtual.min() - 1e-6) & (real <= virtual.max() + 1e-6)))
        if inside >= MIN_OVERLAP:
            continue
        how_many = "No recorded ping lies" if inside == 0 else f"Only {100 * inside:.0f} % of recorded pings lie"
        consequence = "nothing can be compared there" if inside == 0 else "the others cannot be compared"
        yield (
            f"{how_many} within the simulated {name} ({_span(virtual, unit)}; recorded: {_span(real, unit)}): "
            f"{consequence}. Simulate the recorded conditions."
        )


def _span(value: Floats, unit: str) -> str:
    return f"{value.min():.3g} to {value.max():.3g} {unit}".rstrip()
