"""A labelled trial: recordings of a simulated and of a real sonar, and the true difference between them."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from acquisition import Recording, RecordingError
from acquisition.io.files import write_atomic

RECORDINGS = ("simulated", "recorded", "fresh", "fresh_simulated", "fresh_again")
ANSWER = "answer.json"


@dataclass(frozen=True)
class TrueCause:
    """One difference between the real sonar and the simulated one.

    Attributes:
        effect: id in the catalogue of effects.
        accepted: ids that name the cause correctly: `effect`, and those that are equivalent on all data of the family.
        size: strength relative to one that is plain to see.
        parameter: the effect's parameter whose true value is known; None where no parameter has the same meaning.
        value: true value of the parameter of the effect when it is applied to a law of the simulation, in the unit of
            the catalogue.
        aspects: aspects of the readings in which the difference shows; each is a correct answer.
        region: lowest and highest value of conditions between which it acts, SI units ("distance" in m, "angle" in rad,
            "time" in s, covariates by the name of their column); empty for everywhere.
    """

    effect: str
    accepted: tuple[str, ...]
    size: float
    parameter: str | None = None
    value: float | None = None
    aspects: tuple[str, ...] = ()
    region: dict[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Trial:
    """Recordings of a simulated and a real sonar, with the answer.

    Attributes:
        family: of generators.
        kind: "same", "single", "pair", "unmodelled" or "simulator".
        seed: entropy of all random numbers of the trial.
        causes: true causes; empty where there is no difference and where it is in no catalogue.
        fault: plain description of a difference that is in no catalogue; "" otherwise.
        simulated: recording of the simulated sonar.
        recorded: recording of the real sonar.
        fresh: the real sonar under other conditions, with about a third as many pings.
        fresh_simulated: the simulated sonar under the conditions of `fresh`.
        fresh_again: the real sonar once more under the conditions of `fresh`, as a measure of its repeatability.
    """

    family: str
    kind: str
    seed: tuple[int, ...]
    causes: tuple[TrueCause, ...]
    fault: str
    simulated: Recording
    recorded: Recording
    fresh: Recording
    fresh_simulated: Recording
    fresh_again: Recording


def save(trial: Trial, folder: Path) -> Path:
    """Write the recordings as CSV files and the answer as `answer.json`; return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in RECORDINGS:
        getattr(trial, name).save(folder / f"{name}.csv")
    answer = {name: getattr(trial, name) for name in ("family", "kind", "seed", "fault")}
    text = json.dumps({**answer, "causes": [asdict(cause) for cause in trial.causes]}, indent=1)
    write_atomic(folder / ANSWER, lambda file: file.write(text))
    return folder


def load(folder: Path) -> Trial:
    """Read a trial that `save` wrote.

    Raises:
        RecordingError: the folder has no answer.
        RecordingNotFoundError: a recording is missing.
    """
    path = folder / ANSWER
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; give a folder that `sonar-gym generate-trials` wrote")
    answer = json.loads(path.read_text(encoding="utf-8"))
    recordings = (Recording.load(folder / f"{name}.csv") for name in RECORDINGS)
    causes = tuple(_cause(each) for each in answer["causes"])
    return Trial(answer["family"], answer["kind"], tuple(answer["seed"]), causes, answer["fault"], *recordings)


def _cause(answer: dict[str, Any]) -> TrueCause:
    region = {name: (low, high) for name, (low, high) in answer["region"].items()}
    lists = {name: tuple(answer[name]) for name in ("accepted", "aspects")}
    return TrueCause(**{**answer, **lists, "region": region})
