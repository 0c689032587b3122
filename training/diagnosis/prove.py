"""Prove the diagnosis on concealed effects: blind trials, sealed, scored, published.

Each trial is made by one process, diagnosed by another that sees two recordings only, and opened by a third once the
verdict is written down. Everything that happens is in the ledger of the folder; stop at any time, go on with the same
command.
"""

from __future__ import annotations

from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, Literal

from acquisition import SettingError
from acquisition.io.files import write_bytes, write_text
from noise.discrepancy.verdict import CLAIMS
from training.common.commit import commit
from training.common.progress import bar
from training.proof.crew import ENGINES, Bench, Crew
from training.proof.figure import accuracy
from training.proof.page import FAMILY, PICTURE, page
from training.proof.score import TELLABLE, trials_of
from training.proof.seal import OPENED, PROTOCOL, SEALED, VERDICT, Ledger, LedgerError, check, hash_of, salt_of, seed_of


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym prove`."""

    out: Path
    """Folder of the ledger, the recordings and the published page; a run that was stopped goes on."""
    trials: int = 300
    """How many."""
    seed: int = 0
    """With commit, protocol and nonce, what every trial is drawn from."""
    deck: Literal["mixed", "effects", "strangers", "nulls"] = "mixed"
    """What is concealed: everything, or each effect, or each stranger, in turn; or nothing."""
    nonce: str = "public"
    """A word that nobody who worked on the diagnosis could know."""
    workers: int = 2
    """Trials at work at once."""
    engine: Literal["local", "ray"] = "local"
    """Where they run: on this machine, or on the Ray cluster that this machine is part of."""
    leave_out: bool = False
    """Of each trial with one effect, also diagnose it with that effect taken out of the catalogue."""
    quick: bool = False
    """Leave the baselines out."""
    keep: bool = False
    """Keep the recordings of opened trials."""


@dataclass(frozen=True)
class Job:
    """A trial to run, as a worker is told of it: all that it needs, and nothing of other trials."""

    trial: int
    secret: str
    deck: str
    shuffle: str
    folder: str
    leave_out: bool
    quick: bool
    keep: bool


def main(args: Args) -> None:
    """Run what the ledger lacks, then publish; of a run that is stopped, what it has."""
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
    """Write the page and its picture."""
    rig = [trial for trial in trials_of(ledger.lines) if trial.kind != FAMILY]
    write_bytes(out / PICTURE, accuracy(rig))
    write_text(out / "proof.md", page(ledger.lines))


def settings_of(args: Args) -> dict[str, Any]:
    """Return what makes a run: two runs of the same settings are the same run."""
    settings = {"commit": commit(), "protocol": PROTOCOL, "seed": args.seed, "nonce": args.nonce}
    return {**settings, "deck": args.deck, "leave_out": args.leave_out, "quick": args.quick}


def run(args: Args, ledger: Ledger) -> None:
    """Run every trial that is not opened yet; one whose worker died is tried once more, then stays open."""
    done = ledger.of(OPENED)
    left = [k for k in range(args.trials) if k not in done]
    book = Book(ledger)
    with Crew(ENGINES[args.engine], args.workers) as crew, bar("trials", args.trials) as tell:
        tell(args.trials - len(left), args.trials)
        jobs = [crew.submit(trial_of, job_of(args, ledger, trial), book) for trial in left]
        for count, job in enumerate(as_completed(jobs), start=1):
            job.result()
            tell(args.trials - len(left) + count, args.trials)


def job_of(args: Args, ledger: Ledger, trial: int) -> Job:
    """Return a trial's job."""
    settings = ledger.lines[0]["settings"]
    secret, shuffle = (seed_of(settings["commit"], args.seed, args.nonce, k) for k in (trial, -1))
    folder = args.out.absolute() / "trials" / f"{trial:05d}"
    return Job(trial, secret, args.deck, shuffle, str(folder), args.leave_out, args.quick, args.keep)


def trial_of(bench: Bench, job: Job, book: Book) -> None:
    """Run a trial, step by step, in the order of the protocol."""
    folder = {"folder": job.folder}
    asked = {"trial": job.trial, "secret": job.secret, "deck": job.deck, "shuffle": job.shuffle}
    made = bench.ask("generate", {**asked, **folder})
    answer, salt = made["answer"], salt_of(job.secret)
    book.write(SEALED, job.trial, answer_sha256=hash_of(answer, salt), files=made["files"])
    told = book.has(VERDICT, job.trial) or bench.ask("examine", folder)
    book.write(
        VERDICT, job.trial, verdict=told["verdict"], seconds=told["seconds"], verdict_sha256=hash_of(told["verdict"])
    )
    scores = bench.ask("assess", {**folder, "answer": answer, "verdict": told["verdict"], "quick": job.quick})
    scores["followed"] = _followed(bench, {**asked, **folder}, answer, told["verdict"])
    if job.leave_out and answer["kind"] == "effect":
        known = answer["causes"][0]["accepted"]
        scores["left_out"] = bench.ask("examine", {**folder, "without": known})["verdict"]
    book.write(OPENED, job.trial, answer=answer, salt=salt, scores=scores)
    bench.tidy(job.folder, job.keep)


def _followed(bench: Bench, asked: dict[str, Any], answer: dict[str, Any], verdict: dict[str, Any]) -> Any:
    """Return what a measurement tells that the verdict asked for, made in the trial's own world; None without one."""
    wanted = [m for m in verdict["next_settings"] if m["conditions"]] if verdict["verdict"] in CLAIMS else []
    if not wanted or answer["kind"] not in TELLABLE:
        return None
    bench.ask("generate", {**asked, "measure": wanted})
    return bench.ask("examine", {"folder": asked["folder"], "follow": True})["told"]


class Book:
    """The ledger, written by one thread at a time."""

    def __init__(self, ledger: Ledger) -> None:
        """Keep a ledger."""
        self.ledger, self.turn = ledger, Lock()

    def has(self, event: str, trial: int) -> dict[str, Any] | None:
        """Return what a stopped run already wrote of a trial."""
        with self.turn:
            return self.ledger.of(event).get(trial)

    def write(self, event: str, trial: int, **content: Any) -> None:
        """Write a step; one that a stopped run already wrote must be the same."""
        before = self.has(event, trial)
        if before is None:
            with self.turn:
                self.ledger.append(event, trial=trial, **content)
        elif event == SEALED and before["answer_sha256"] != content["answer_sha256"]:
            raise LedgerError(f"trial {trial}: made anew, its answer has another hash; was the program changed?")
