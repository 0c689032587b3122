"""Blind trials of the diagnosis: concealed effects, sealed answers, published scores.

One process generates a trial, a second one diagnoses it from two recordings only, and a third one scores it after the
verdict is recorded. The ledger in the output folder records every step; the same command resumes an interrupted run.
"""

from __future__ import annotations

from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, Literal

from acquisition import SettingError
from acquisition.io.files import write_bytes, write_text
from noise.discrepancy.judge.verdict import CLAIMS
from training.common.commit import commit
from training.common.progress import bar
from training.proof.crew import ENGINES, Bench, Crew
from training.proof.scoring.figure import accuracy
from training.proof.scoring.page import FAMILY, PICTURE, page
from training.proof.scoring.score import TELLABLE, trials_of
from training.proof.seal import OPENED, PROTOCOL, SEALED, VERDICT, Ledger, LedgerError, check, hash_of, salt_of, seed_of


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym prove`."""

    out: Path
    """Folder of the ledger, the recordings and the page; an interrupted run is resumed."""
    trials: int = 300
    """Number of trials."""
    seed: int = 0
    """Seed of the trials, together with commit, protocol and nonce."""
    deck: Literal["mixed", "effects", "strangers", "nulls"] = "mixed"
    """Concealed effects: mixed; every effect of the catalogue; every fault outside it (strangers); or none."""
    nonce: str = "public"
    """Word that the developers of the diagnosis could not know."""
    workers: int = 2
    """Number of trials in parallel."""
    engine: Literal["local", "ray"] = "local"
    """local: this machine. ray: the Ray cluster to which it belongs."""
    leave_out: bool = False
    """Diagnose each trial with one effect also without that effect in the catalogue."""
    quick: bool = False
    """Skip the baselines."""
    keep: bool = False
    """Keep the recordings of finished trials."""


@dataclass(frozen=True)
class Job:
    """Parameters of one trial for a worker, without any information on other trials."""

    trial: int
    secret: str
    deck: str
    shuffle: str
    folder: str
    leave_out: bool
    quick: bool
    keep: bool


def main(args: Args) -> None:
    """Run the missing trials and write the page, also after an interruption."""
    if args.trials < 1 or args.workers < 1:
        raise SettingError(f"--trials and --workers must be at least 1, got {args.trials} and {args.workers}")
    ledger = Ledger.open(args.out / "ledger.jsonl", settings_of(args))
    try:
        run(args, ledger)
    finally:
        check(ledger.lines)
        publish(args.out, ledger)
        ledger.close()
    print(f"{len(ledger.of(OPENED))} trials in {ledger.path}; the tables are in {args.out / 'proof.md'}")


def publish(out: Path, ledger: Ledger) -> None:
    """Write the page and its figure."""
    rig = [trial for trial in trials_of(ledger.lines) if trial.kind != FAMILY]
    write_bytes(out / PICTURE, accuracy(rig))
    write_text(out / "proof.md", page(ledger.lines))


def settings_of(args: Args) -> dict[str, Any]:
    """Return the settings that identify a run."""
    settings = {"commit": commit(), "protocol": PROTOCOL, "seed": args.seed, "nonce": args.nonce}
    return {**settings, "deck": args.deck, "leave_out": args.leave_out, "quick": args.quick}


def run(args: Args, ledger: Ledger) -> None:
    """Run every trial without a score; a trial whose worker died is run once more."""
    done = ledger.of(OPENED)
    left = [k for k in range(args.trials) if k not in done]
    book = Book(ledger)
    with Crew(ENGINES[args.engine], args.workers) as crew, bar("trials", args.trials) as update:
        update(args.trials - len(left), args.trials)
        jobs = [crew.submit(trial_of, job_of(args, ledger, trial), book) for trial in left]
        for count, job in enumerate(as_completed(jobs), start=1):
            job.result()
            update(args.trials - len(left) + count, args.trials)


def job_of(args: Args, ledger: Ledger, trial: int) -> Job:
    """Return the parameters of a trial."""
    settings = ledger.lines[0]["settings"]
    secret, shuffle = (seed_of(settings["commit"], args.seed, args.nonce, k) for k in (trial, -1))
    folder = args.out.absolute() / "trials" / f"{trial:05d}"
    return Job(trial, secret, args.deck, shuffle, str(folder), args.leave_out, args.quick, args.keep)


def trial_of(bench: Bench, job: Job, book: Book) -> None:
    """Run one trial in the order of the protocol."""
    folder = {"folder": job.folder}
    question = {"trial": job.trial, "secret": job.secret, "deck": job.deck, "shuffle": job.shuffle}
    made = bench.ask("generate", {**question, **folder})
    answer, salt = made["answer"], salt_of(job.secret)
    book.write(SEALED, job.trial, answer_sha256=hash_of(answer, salt), files=made["files"])
    result = book.has(VERDICT, job.trial) or bench.ask("examine", folder)
    verdict = result["verdict"]
    book.write(VERDICT, job.trial, verdict=verdict, seconds=result["seconds"], verdict_sha256=hash_of(verdict))
    scores = bench.ask("assess", {**folder, "answer": answer, "verdict": verdict, "quick": job.quick})
    scores["followed"] = _followed(bench, {**question, **folder}, answer, verdict)
    if job.leave_out and answer["kind"] == "effect":
        known = answer["causes"][0]["accepted"]
        scores["left_out"] = bench.ask("examine", {**folder, "without": known})["verdict"]
    book.write(OPENED, job.trial, answer=answer, salt=salt, scores=scores)
    bench.tidy(job.folder, job.keep)


def _followed(bench: Bench, question: dict[str, Any], answer: dict[str, Any], verdict: dict[str, Any]) -> Any:
    """Return the score of the measurement that the verdict requests, made in the trial's world; None without one."""
    wanted = [m for m in verdict["next_settings"] if m["conditions"]] if verdict["verdict"] in CLAIMS else []
    if not wanted or answer["kind"] not in TELLABLE:
        return None
    bench.ask("generate", {**question, "measure": wanted})
    return bench.ask("examine", {"folder": question["folder"], "follow": True})["told"]


class Book:
    """A ledger that several threads write to."""

    def __init__(self, ledger: Ledger) -> None:
        self.ledger, self.turn = ledger, Lock()

    def has(self, event: str, trial: int) -> dict[str, Any] | None:
        """Return the record of an event of a trial, if any."""
        with self.turn:
            return self.ledger.of(event).get(trial)

    def write(self, event: str, trial: int, **content: Any) -> None:
        """Write an event, or check that an existing record of it agrees."""
        before = self.has(event, trial)
        if before is None:
            with self.turn:
                self.ledger.append(event, trial=trial, **content)
        elif event == SEALED and before["answer_sha256"] != content["answer_sha256"]:
            raise LedgerError(
                f"trial {trial}: the answer has another hash than before; check that the code is unchanged"
            )
