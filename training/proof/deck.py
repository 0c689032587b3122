"""What is planned: the number of trials of each family and kind, and the code that makes and diagnoses them."""

from __future__ import annotations

import json
import platform
from collections import Counter
from collections.abc import Mapping
from importlib.metadata import version
from itertools import cycle, islice
from pathlib import Path
from typing import Any

from noise.discrepancy.judge.decision import WEIGHTS
from training.common.checksum import sha256
from training.common.commit import ROOT, commit
from training.diagnosis.generators.ensemble import FAMILIES, PAIR, SAME, SIMULATOR, SINGLE, UNMODELLED, kinds_of
from training.diagnosis.judging.command import LEFT_OUT
from training.diagnosis.judging.tasks import HARD_CASE

# shares of all trials, so that 300 hold 60 nulls, 60 unmodelled faults, and 42 pairs; single causes are the others
SHARES = {SAME: 0.2, UNMODELLED: 0.2, PAIR: 0.14, SIMULATOR: 0.04}
MATCHED = ("matched_scale", "matched_offset")  # histogram, mean and standard deviation of the two files agree
MATCHED_SHARE = 0.06
SOURCES = ("acquisition", "noise", "training/common", "training/diagnosis", "training/proof")
LIBRARIES = ("numpy", "scipy", "pandas", "torch", "scikit-learn")
SCHEMA = 3  # of ledgers; before, trials followed from no secret, and the table was counted by other rules
Cell = tuple[str, str]  # family, kind


def planned(trials: int) -> Counter[Cell]:
    """Return the number of trials of each family and kind; families take turns."""
    counts = {kind: round(share * trials) for kind, share in SHARES.items()}
    matched = round(MATCHED_SHARE * trials)
    counts[SINGLE] = max(trials - sum(counts.values()) - matched, 0)
    cells = [(HARD_CASE, kind) for kind in islice(cycle(MATCHED), matched)]
    for kind, count in counts.items():
        able = [family for family in FAMILIES if kind in kinds_of(family)]
        cells += [(family, kind) for family in islice(cycle(able), count)]
    return Counter(cells[:trials])


def deck_of(trials: int, pings: int, left_out: int, secret: bytes) -> dict[str, Any]:
    """Return the first line of a ledger.

    Args:
        trials: number of them.
        pings: approximate number in each recording.
        left_out: number of single causes that are also diagnosed without the true effect in the catalogue.
        secret: from which the trials follow; no two decks have the same, so that none have the same hash.
    """
    counts = planned(trials)
    card = json.loads(WEIGHTS.read_text())["card"]
    return {
        "schema": SCHEMA,
        "trials": trials,
        "pings": pings,
        "left_out": left_out,
        "planned": [[family, kind, counts[family, kind]] for family, kind in sorted(counts)],
        "unfitted": list(card.get("families left out", LEFT_OUT)),
        "commit": commit(),
        **hashes(),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}},
        "secret_sha256": sha256(secret),
    }


def hashes() -> dict[str, str]:
    """Return the SHA-256 of the catalogue of effects, of the decision model, and of all code that takes part."""
    return {
        "catalogue_sha256": hash_of_files("noise/effects"),
        "decision_sha256": sha256(WEIGHTS.read_bytes()),
        "source_sha256": hash_of_files(*SOURCES),
    }


def hash_of_files(*folders: str) -> str:
    """Return the SHA-256 of the names and contents of all Python and JSON files below folders of the project."""
    paths = sorted(path for folder in folders for suffix in ("py", "json") for path in _below(ROOT / folder, suffix))
    return sha256("".join(f"{path.relative_to(ROOT).as_posix()} {sha256(path.read_bytes())}\n" for path in paths))


def _below(folder: Path, suffix: str) -> list[Path]:
    return list(folder.rglob(f"*.{suffix}"))


def cells_of(deck: Mapping[str, Any]) -> Counter[Cell]:
    """Return the planned number of trials of each family and kind."""
    return Counter({(family, kind): count for family, kind, count in deck["planned"]})
