"""The generating process: makes the two recordings of a trial from its secret and returns the answer."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from training.proof.desk import serve
from training.proof.examine import RECORDED, SIMULATED
from training.proof.seal import hash_of_file
from training.proof.trials.follow import measure
from training.proof.trials.mix import card_of, make


def generator(secret: str, purpose: str) -> np.random.Generator:
    """Return a generator that follows from a secret and a purpose."""
    digest = hashlib.sha256(f"{secret}|{purpose}".encode()).digest()
    return np.random.default_rng(list(digest))


def generated(question: dict[str, Any]) -> dict[str, Any]:
    """Write the recordings of a trial; return its answer and the hashes of both files.

    Args:
        question: `trial`; its `secret`; `deck`, and `shuffle`, the secret of its order; `folder` for the recordings;
            `kind`, `name` and `size` in place of the deck's, where given; `measure`, what a verdict asks for next,
            which is then recorded beside them.
    """
    card: tuple[str, str | None] = (question.get("kind", ""), question.get("name"))
    if not card[0]:
        card = card_of(question["trial"], question["deck"], lambda n: generator(question["shuffle"], f"block {n}"))
    trial = make(card[0], generator(question["secret"], "trial"), card[1], question.get("size"))
    folder = Path(question["folder"])
    folder.mkdir(parents=True, exist_ok=True)
    trial.simulated.save(folder / SIMULATED)
    trial.recorded.save(folder / RECORDED)
    files = {name: hash_of_file(folder / name) for name in (SIMULATED, RECORDED)}
    if question.get("measure"):
        more = measure(trial, question["measure"], folder, generator(question["secret"], "next"))
        files |= {path.name: hash_of_file(path) for path in more.values()}
    return {"answer": {"trial": question["trial"], **trial.answer}, "files": files}


if __name__ == "__main__":
    serve(generated)
