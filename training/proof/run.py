"""Blind trials of the diagnosis: sealed, diagnosed, disclosed and scored, in a ledger that anybody can verify.

The same command goes on with an interrupted run. Trials at work when it was interrupted are recorded as lost and never
run again, since their verdicts may have been seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from acquisition.io.files import write_bytes
from acquisition.io.places import Output, OutputFile, OutputFolder
from acquisition.limits import Count, Limit, Workers
from training.common.checksum import sha256
from training.common.progress import bar
from training.diagnosis.judging.tasks import Task, case_of
from training.proof import real
from training.proof.chain import Chain, ProofError, of_event
from training.proof.deck import deck_of, hashes
from training.proof.diagnosing import RECORDED, SIMULATED
from training.proof.ledger import (
    CLOSED,
    DECK,
    DISCLOSED,
    LEFT_OUT,
    RESUMED,
    SCORED,
    SEALED,
    VERDICT,
    answers_of,
    context_of,
    left_out_trials,
    lost_of,
    without_of,
)
from training.proof.page import publish, table_of
from training.proof.sealing import seal
from training.proof.secret import key_of, new_secret, order_of, secret_of, seed_of
from training.proof.work import (
    Call,
    Diagnose,
    Files,
    answer_of,
    diagnosed,
    files_of,
    local,
    on_ray,
    scored,
    task_of,
)

Score = Callable[[dict[str, Any], bytes], dict[str, Any]]
LEDGER = "ledger.jsonl"


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym prove`."""

    out: Annotated[Path, Output("folder", "ledger.jsonl")]
    """Folder of the ledger; an interrupted run goes on."""
    trials: Count = 300
    """Number of trials."""
    pings: Count = 2000
    """Approximate number in each recording."""
    left_out: Annotated[int, Limit(0, 1_000_000)] = 30
    """Number of single causes that are also diagnosed without the true effect in the catalogue."""
    workers: Workers = 2
    """Number of trials in parallel."""
    ray: bool = False
    """Diagnose and score on a Ray cluster."""
    plan: bool = False
    """Only write the deck, whose hash can then be published before the trials are run."""
    pages: OutputFolder | None = None
    """Folder of the page and its figures; `out` by default, where the table of each family is."""
    announce: OutputFile | None = None
    """File to which the hashes of the deck and of the closing line are added, for the repository."""


def main(args: Args) -> None:
    """Run what is missing, close the ledger and write the page."""
    chain = opened(args)
    try:
        if not args.plan:
            with (on_ray if args.ray else local)(args.workers) as call:
                Runner(chain, args.out, args.workers, call).run()
            close(chain, args.announce)
            print(publish(chain.lines, args.pages or args.out, args.out))
        print(f"{chain.path}: deck {chain.lines[0]['hash']}, last line {chain.lines[-1]['hash']}")
    finally:
        chain.close()


def opened(args: Args) -> Chain:
    """Return the ledger, with its deck.

    Raises:
        ProofError: it was begun with other settings or other code.
    """
    chain = Chain.open(args.out / LEDGER)
    settings = {"trials": args.trials, "pings": args.pings, "left_out": args.left_out}
    if not chain.lines:
        chain.append((DECK, deck_of(**settings, secret=new_secret(args.out))))
    for name, value in {"event": DECK, **settings, **hashes()}.items():
        before = chain.lines[0].get(name)
        if before != value:
            chain.close()
            raise ProofError(f"{chain.path}: begun with {name} {before}, now {value}; give another --out")
    announce(args.announce, f"deck {chain.lines[0]['hash']} {args.trials} trials")
    return chain


def announce(path: Path | None, line: str) -> None:
    """Add a line to the file of published hashes, unless it is there."""
    if path is not None and not (path.is_file() and line in path.read_text(encoding="utf-8").splitlines()):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")


def close(chain: Chain, path: Path | None) -> None:
    """Write the closing line, once, with the secret and the table that follows from all the others."""
    lines = chain.lines
    if lines[-1]["event"] != CLOSED:
        answers, secret = answers_of(lines), secret_of(chain.path.parent, lines[0])
        content = {"disclosed": len(answers), "lost": lost_of(lines), "table": table_of(lines, answers)}
        chain.append((CLOSED, {**content, "secret": secret.hex()}))
    announce(path, f"closed {chain.lines[0]['hash']} {chain.lines[-1]['hash']}")


class Runner:
    """Runs the trials of a deck in threads that wait for worker processes; secret and keys stay in this process."""

    def __init__(
        self,
        chain: Chain,
        out: Path,
        workers: int,
        call: Call,
        diagnose: Diagnose = diagnosed,
        score: Score = scored,
    ) -> None:
        self.chain, self.out, self.workers, self.call = chain, out, workers, call
        self.diagnose, self.score = diagnose, score

    def run(self) -> None:
        """Run all trials that were never begun, score those that have no score, then leave effects out."""
        chain = self.chain
        if chain.lines[-1]["event"] == CLOSED:
            return
        self.secret = secret_of(self.out, chain.lines[0])
        self.cells = order_of(self.secret, chain.lines[0])
        self.resume()
        begun = chain.of(SEALED)
        self.each("trials", self.trial, [t for t in range(chain.lines[0]["trials"]) if t not in begun])
        answers, known = answers_of(chain.lines), chain.of(SCORED)
        self.each("scoring", self.rescue, [t for t in answers if t not in known])
        known = chain.of(LEFT_OUT)
        self.each("leaving out", self.leave_out, [t for t in left_out_trials(chain.lines, answers) if t not in known])
        for case in real.available():
            if case.name not in {line.get("name") for line in chain.lines}:
                chain.append((real.EVENT, real.diagnosed_case(case, self.diagnose)))

    def each(self, name: str, work: Callable[[int], None], trials: Sequence[int]) -> None:
        """Do work on each trial in threads; the first error ends the run when the trials at work are done."""
        pool = ThreadPoolExecutor(self.workers)
        jobs: list[Future[None]] = [pool.submit(work, trial) for trial in trials]
        try:
            with bar(name, len(jobs)) as update:
                for count, job in enumerate(as_completed(jobs), 1):
                    job.result()
                    update(count, len(jobs))
        finally:
            pool.shutdown(cancel_futures=True)

    def resume(self) -> None:
        """Record that a run goes on, and which trials are lost because they were not disclosed."""
        lines = self.chain.lines
        lost = of_event(lines, SEALED).keys() - of_event(lines, DISCLOSED).keys() - set(lost_of(lines))
        if len(lines) > 1:
            self.chain.append((RESUMED, {"lost": sorted(lost)}))

    def trial(self, trial: int) -> None:
        """Run one trial: draw, seal, diagnose, record the verdict, disclose, score."""
        task = Task(*self.cells[trial], trial, seed_of(self.secret, trial), self.chain.lines[0]["pings"])
        case = case_of(task)
        answer, files, key = answer_of(task, case), files_of(case), key_of(self.secret, trial)
        sealed = seal(answer, key, context_of(self.chain.lines, trial))
        self.chain.append((SEALED, {"trial": trial, **sealed, "files": hashes_of(files)}))
        result, model = self.call(self.diagnose, given(files))
        write_bytes(self.model(trial), model)
        verdict = {"trial": trial, **result, "model_sha256": sha256(model)}
        self.chain.append((VERDICT, verdict), (DISCLOSED, {"trial": trial, "key": key.hex()}))
        self.finish(trial, answer, model)

    def model(self, trial: int) -> Path:
        """Return the file of a diagnosis that has not been scored."""
        return self.out / "unscored" / f"{trial}.json"

    def finish(self, trial: int, answer: dict[str, Any], model: bytes) -> None:
        """Score a disclosed trial; a diagnosis that ended in an error has no scores."""
        content = self.call(self.score, answer, model) if model else None
        self.chain.append((SCORED, {"trial": trial, "content": content}))
        self.model(trial).unlink(missing_ok=True)

    def rescue(self, trial: int) -> None:
        """Score a trial that was interrupted after its disclosure, by the diagnosis that its verdict names.

        Raises:
            ProofError: its file is gone, and the diagnosis does not repeat bit by bit.
        """
        path, expected = self.model(trial), self.chain.of(VERDICT)[trial]["model_sha256"]
        answer = answers_of(self.chain.lines)[trial]
        model = path.read_bytes() if path.is_file() else b""
        if sha256(model) != expected:
            _, model = self.call(self.diagnose, given(files_of(case_of(task_of(answer)))))
        if sha256(model) != expected:
            raise ProofError(
                f"{path}: is not the diagnosis with SHA-256 {expected}, whose verdict the ledger holds, and a new one "
                f"has {sha256(model)}; put the file back, or go on with the machine that made it"
            )
        self.finish(trial, answer, model)

    def leave_out(self, trial: int) -> None:
        """Diagnose a disclosed trial without the true effect in the catalogue."""
        answer = answers_of(self.chain.lines)[trial]
        without = without_of(answer)
        result, _ = self.call(self.diagnose, given(files_of(case_of(task_of(answer)))), without)
        self.chain.append((LEFT_OUT, {"trial": trial, "without": list(without), **result}))


def hashes_of(files: Files) -> dict[str, str]:
    """Return the SHA-256 of each file."""
    return {name: sha256(data) for name, data in files.items()}


def given(files: Files) -> Files:
    """Return the two files that a diagnosing process gets."""
    return {name: files[name] for name in (SIMULATED, RECORDED)}
