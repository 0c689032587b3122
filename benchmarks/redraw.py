"""Draw the figures of experiments again, in seconds, from their records; the experiments take minutes to hours.

    python -m benchmarks.redraw

Beside each figure lies its record, which holds what is drawn, the command and the commit that made it. The figures of
the shipped agent, of the decision model and of the proof are drawn from the agent, from the model's card and from the
ledger.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from acquisition.io.files import write_bytes
from benchmarks import calibration, crosstalk, curves, fidelity
from examples import train_highway
from noise.discrepancy.judge.decision import WEIGHTS
from sonar_gym.agent import load_policy
from training.agents import transfer
from training.agents.train import learning_curve
from training.common.commit import ROOT
from training.common.records import read_record
from training.diagnosis.judging import fit_command
from training.noise import report
from training.proof import page
from training.proof.chain import load
from training.thesis import compare_thesis

DOCS = ROOT / "docs"
LEDGER = ROOT / "benchmarks" / "records" / "proof" / "ledger.jsonl.xz"
DRAWN: dict[str, Callable[[Any], bytes]] = {  # from the record beside it
    "images/cross-talk.png": crosstalk.figure,
    "images/calibration.png": calibration.figure,
    "images/fidelity.png": fidelity.figure,
    "images/curves.png": curves.figure,
    "images/highway.png": train_highway.figure,
    "images/transfer.png": transfer.figure,
    "explanation/images/noise-credence.png": report.figure,
    "explanation/thesis/rig/rig-versus-thesis.png": compare_thesis.figure,
}
MADE: dict[str, Callable[[], bytes]] = {
    "images/learning.png": lambda: learning_curve(load_policy("parking").about["history"]),
    "images/decision-reliability.png": lambda: fit_command.figure(json.loads(WEIGHTS.read_text("utf-8"))["card"]),
    "explanation/proof.png": lambda: page.picture(load(LEDGER)),
}


def pictures() -> dict[Path, bytes]:
    """Return each figure as PNG by its path."""
    drawn = {DOCS / name: draw(read_record(DOCS / name)) for name, draw in DRAWN.items()}
    return drawn | {DOCS / name: make() for name, make in MADE.items()}


def main() -> None:
    """Draw all figures."""
    for path, content in pictures().items():
        write_bytes(path, content)


if __name__ == "__main__":
    main()
