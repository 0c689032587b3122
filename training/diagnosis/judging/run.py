"""Diagnose many tasks and keep one line of JSON for each; an interrupted run goes on where it stopped."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import as_completed
from pathlib import Path

from pydantic import ValidationError

from acquisition import RecordingError
from acquisition.limits import shown
from training.common.progress import bar
from training.common.workers import worker_processes
from training.diagnosis.judging.record import Record, record_of
from training.diagnosis.judging.schema import check_line
from training.diagnosis.judging.tasks import Task

RECORDS = "records.jsonl"


def run(tasks: Iterable[Task], out: Path, workers: int, judge: Callable[[Task], Record] = record_of) -> list[Record]:
    """Diagnose the tasks that have no record yet; return the records of all tasks.

    Args:
        tasks: what to diagnose.
        out: folder of the records.
        workers: number of processes; 1 works in this process.
        judge: makes the record of a task.
    """
    tasks, path = list(tasks), out / RECORDS
    out.mkdir(parents=True, exist_ok=True)
    known = {record["id"] for record in read(out)}
    missing = [task for task in tasks if task.id not in known]
    with bar("diagnosing", len(missing)) as update:
        for done, record in enumerate(_records(missing, workers, judge), 1):
            append(path, record)
            update(done, len(missing))
    wanted = {task.id for task in tasks}
    return [record for record in read(out) if record["id"] in wanted]


def _records(tasks: list[Task], workers: int, judge: Callable[[Task], Record]) -> Iterator[Record]:
    if workers == 1:
        yield from map(judge, tasks)
        return
    with worker_processes(min(workers, max(len(tasks), 1))) as pool:
        for future in as_completed([pool.submit(judge, task) for task in tasks]):
            yield future.result()


def append(path: Path, record: Record) -> None:
    """Write a record as one line and force it to disk."""
    with path.open("ab") as file:
        file.write(json.dumps(record).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())


def read(out: Path) -> list[Record]:
    """Return the records of a folder, one per task; a line that an interruption cut short is removed from the file."""
    path = out / RECORDS
    if not path.is_file():
        return []
    text = path.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if len(whole) < len(text):
        with path.open("ab") as file:
            file.truncate(len(whole))
    found = {}
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            check_line(line)
        except (ValueError, RecursionError) as error:
            raise RecordingError(f"{path}: line {number}: {_reason(error)}; remove it, or give another --out") from None
        record = json.loads(line)
        found[record["id"]] = record
    return list(found.values())


def _reason(error: Exception) -> str:
    """Return in a few words why a line is no record."""
    if not isinstance(error, ValidationError):
        return f"no record of a trial ({error})"
    first = error.errors(include_url=False)[0]
    place = ".".join(map(str, first["loc"]))
    return f"no record of a trial by this version ({place}: {shown(first['msg'])})"
