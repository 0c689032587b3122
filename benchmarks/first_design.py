"""The diagnosis of the first design, commit 802bd60, on the trials of a proof that the table of baselines counts.

    python -m benchmarks.first_design runs/proof/ledger.jsonl

Needs the repository's history, and a closed ledger: recordings are made again from the disclosed seeds, and must have
the hashes that the ledger holds. Each is diagnosed by the earlier code in a process of its own, in a folder that holds
nothing else. Writes `first-design.jsonl` beside the ledger; the same command goes on after an interruption.
"""

from __future__ import annotations

import argparse
import io
import json
import subprocess
import tarfile
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from acquisition.io.files import write_text
from training.common.commit import ROOT
from training.common.progress import bar
from training.diagnosis.judging.tasks import case_of
from training.proof.chain import Line, ProofError, load, of_event
from training.proof.diagnosing import RESULT
from training.proof.ledger import CLOSED, SEALED, answers_of, records_of
from training.proof.page import FIRST_DESIGN, compared
from training.proof.run import given, hashes_of
from training.proof.work import Files, files_of, result_of, task_of

COMMIT = "802bd607ca03700b3d13a5c05a074dfbcb8bd4ae"
# what the earlier command does with two files and an ideal model, with errors written instead of raised
PROGRAM = f"""
import json, time
from pathlib import Path
from acquisition import Recording
from noise.discrepancy import diagnose
from noise.store import load_model

if __name__ == "__main__":
    begin, result = time.perf_counter(), {{"verdict": None, "error": None}}
    try:
        simulated = Recording.load(Path("simulated.csv"))
        found = diagnose(load_model("ideal"), Recording.load(Path("recorded.csv")), simulated=simulated, seed=0)
        result["verdict"] = found.to_verdict()
    except Exception as error:
        result["error"] = f"{{type(error).__name__}}: {{error}}"
    Path("{RESULT}").write_text(json.dumps({{**result, "seconds": round(time.perf_counter() - begin, 2)}}))
"""
KEPT = ("effect", "probability", "gain_nats", "indistinguishable_from")  # of each effect of a verdict
Diagnose = Callable[[Files], dict[str, Any]]


def checked_out(folder: Path) -> Path:
    """Write the files of the commit into a folder and return it."""
    done = subprocess.run(["git", "archive", COMMIT], cwd=ROOT, capture_output=True, check=True)
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(folder, filter="data")
    return folder


def entry(trial: int, answer: dict[str, Any], sealed: Line, diagnose: Diagnose) -> dict[str, Any]:
    """Return the line of a trial.

    Raises:
        ProofError: its recordings do not follow from its seed.
    """
    files = files_of(case_of(task_of(answer)))
    if hashes_of(files) != sealed["files"]:
        raise ProofError(f"trial {trial}: its recordings do not follow from its seed")
    result = diagnose(given(files))
    said = result["verdict"]
    verdict = said and {
        "verdict": said["verdict"],
        "p_value": said["p_value"],
        "effects": [{name: effect[name] for name in KEPT} for effect in said["effects"]],
    }
    return {"trial": trial, **result, "verdict": verdict}


def record(ledger: Path, workers: int, diagnose: Diagnose) -> Path:
    """Diagnose the trials that the record lacks, and return its path."""
    lines, path = load(ledger), ledger.parent / FIRST_DESIGN
    if lines[-1]["event"] != CLOSED:
        raise ProofError(f"{ledger}: is not closed; finish it by the same `sonar-gym prove`")
    answers, sealed = answers_of(lines), of_event(lines, SEALED)
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    whole = text[: text.rfind("\n") + 1]  # an interruption may have cut the last line
    write_text(path, whole or json.dumps({"deck": lines[0]["hash"], "commit": COMMIT}) + "\n")
    known = {json.loads(line)["trial"] for line in whole.splitlines()[1:]}
    left = [r["trial"] for group in compared(records_of(lines, answers)) for r in group if r["trial"] not in known]
    with ThreadPoolExecutor(workers) as pool, path.open("a", encoding="utf-8") as file, bar("trials", len(left)) as on:
        jobs = [pool.submit(entry, trial, answers[trial], sealed[trial], diagnose) for trial in left]
        for count, job in enumerate(as_completed(jobs), 1):
            file.write(json.dumps(job.result()) + "\n")
            file.flush()
            on(count, len(jobs))
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ledger", type=Path, help="closed ledger of `sonar-gym prove`")
    parser.add_argument("--workers", type=int, default=2, help="number of trials in parallel")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="first-design-") as name:
        code = checked_out(Path(name))
        print(record(args.ledger, args.workers, lambda files: result_of(["-c", PROGRAM], files, code)[0]))


if __name__ == "__main__":
    main()
