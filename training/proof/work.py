"""What worker processes do for the proof, on this machine or on a Ray cluster; none of them holds a key."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from acquisition import Recording
from acquisition.extras import require
from training.common.commit import ROOT
from training.common.workers import worker_processes
from training.diagnosis.generators.trial import RECORDINGS
from training.diagnosis.judging.record import judged
from training.diagnosis.judging.tasks import Case, Task, case_of
from training.proof.baselines import baselines
from training.proof.diagnosing import MODEL, RECORDED, RESULT, SIMULATED
from training.proof.parcel import unpacked

Files = dict[str, bytes]
Result = dict[str, Any]
Diagnose = Callable[..., tuple[Result, bytes]]  # (files, ids left out) -> result, and the diagnosis as bytes
Call = Callable[..., Any]  # (function, *arguments) -> its result, from a worker
TASK = ("family", "kind", "number", "seed", "pings")
PROGRAM = ("-m", "training.proof.diagnosing")
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA")
KEPT = ("PATH", "LANG", "LD_LIBRARY_PATH", "SYSTEMROOT")  # what Python needs of the environment


def answer_of(task: Task, case: Case) -> dict[str, Any]:
    """Return what is concealed: the seed of everything, and the true difference."""
    causes = [asdict(cause) for cause in case.causes]
    return {**asdict(task), "causes": causes, "fault": case.fault, "n": len(case.recorded)}


def task_of(answer: Mapping[str, Any]) -> Task:
    """Return the task of a disclosed answer."""
    return Task(**{name: answer[name] for name in TASK})


def files_of(case: Case) -> Files:
    """Return the recordings of a trial as CSV files."""
    recordings = (case.simulated, case.recorded, *case.fresh)
    return {f"{name}.csv": as_csv(each) for name, each in zip(RECORDINGS, recordings, strict=False)}


def as_csv(recording: Recording) -> bytes:
    """Return a recording as the bytes of a CSV file, with ten digits, as in the published ledgers."""
    text: str = recording.table.to_csv(index=False, float_format="%.10g", lineterminator="\n")
    return text.encode()


def diagnosed(files: Files, without: tuple[str, ...] = ()) -> tuple[Result, bytes]:
    """Return the result of a diagnosis in a process of its own, and the diagnosis as bytes.

    Args:
        files: of which `recorded.csv` and, if it is there, `simulated.csv` are given.
        without: ids of effects that are taken out of the catalogue.
    """
    return result_of([*PROGRAM, *without], files)


def result_of(program: Sequence[str], files: Files, code: Path = ROOT) -> tuple[Result, bytes]:
    """Return what a new process writes that gets two files in an empty folder: the result, and the diagnosis as bytes.

    Args:
        program: arguments of Python.
        files: as in `diagnosed`.
        code: folder from which the process imports.
    """
    with tempfile.TemporaryDirectory(prefix="diagnosis-") as name:
        folder = Path(name)
        for file in (SIMULATED, RECORDED):
            if file in files:
                (folder / file).write_bytes(files[file])
        done = subprocess.run(
            [sys.executable, *program], cwd=folder, env=environment(code), capture_output=True, text=True,
            start_new_session=True,  # Ctrl-C must not end a diagnosis, which would be recorded as its failure
        )  # fmt: skip
        if not (folder / RESULT).is_file():
            words = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
            return {"verdict": None, "error": f"the process ended: {words[-1]}", "seconds": 0.0}, b""
        model = folder / MODEL
        return json.loads((folder / RESULT).read_text()), model.read_bytes() if model.is_file() else b""


def environment(code: Path = ROOT) -> dict[str, str]:
    """Return the whole environment of a diagnosing process that imports from a folder."""
    kept = {name: os.environ[name] for name in KEPT if name in os.environ}
    return {**kept, "PYTHONPATH": str(code), **{f"{name}_NUM_THREADS": "1" for name in THREADS}}


def scored(answer: Mapping[str, Any], model: bytes) -> dict[str, Any]:
    """Return evidence, overlap of regions, and scores on the fresh recordings of a disclosed trial, with baselines.

    An error is returned, not raised, and counts against the diagnosis.

    Args:
        answer: as it was sealed.
        model: the diagnosis that `diagnosed` returned.
    """
    try:
        return _scored(answer, model)
    except Exception as error:
        return {"error": f"scoring: {type(error).__name__}: {error}"}


def _scored(answer: Mapping[str, Any], model: bytes) -> dict[str, Any]:
    with threadpool_limits(1):
        case, found = case_of(task_of(answer)), unpacked(model)
        recorded = found.recorded(case.recorded)
        content = judged(case, found.said, recorded, found.models)
        names, crps = baselines(case, recorded, found.models["emulator"])
        return {**content, "scores": content["scores"] and {**content["scores"], **crps}, "baselines": names}


@contextmanager
def local(workers: int) -> Iterator[Call]:
    """Yield the calls of processes on this machine."""
    with worker_processes(workers) as pool:
        yield lambda function, *arguments: pool.submit(function, *arguments).result()


@contextmanager
def on_ray(workers: int) -> Iterator[Call]:
    """Yield the calls of tasks on the Ray cluster that this machine belongs to, or on one of its own.

    Raises:
        MissingExtraError: Ray is not installed.
    """
    require("ray", "ray")
    import ray

    ray.init(log_to_driver=False, include_dashboard=False, ignore_reinit_error=True)
    try:
        yield lambda function, *arguments: ray.get(ray.remote(function).remote(*arguments))
    finally:
        ray.shutdown()
