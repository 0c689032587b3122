"""The diagnosing program: it finds two recordings in its working folder and knows nothing else about them.

It writes result.json (verdict or error, seconds) and what else is scored of the diagnosis once the answer is disclosed.
Arguments are ids of effects that are taken out of the catalogue.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from acquisition import Recording
from noise import IdealModel, discrepancy
from training.proof.parcel import packed

SIMULATED, RECORDED, RESULT, MODEL = "simulated.csv", "recorded.csv", "result.json", "diagnosis.json"
SEED = 0  # of every diagnosis


def main(folder: Path, without: tuple[str, ...]) -> None:
    """Diagnose the recordings of a folder; an error is written, not raised, and counts against the diagnosis."""
    begin, model = time.perf_counter(), b""
    result: dict[str, Any] = {"verdict": None, "error": None}
    try:
        given = folder / SIMULATED
        simulated = Recording.load(given) if given.is_file() else None
        recorded = Recording.load(folder / RECORDED)
        found = discrepancy.diagnose(IdealModel(), recorded, simulated=simulated, seed=SEED, without=without)
        result["verdict"], model = found.verdict.to_dict(), packed(found)
    except Exception as error:
        result["error"] = f"{type(error).__name__}: {error}"
    result["seconds"] = round(time.perf_counter() - begin, 2)
    (folder / MODEL).write_bytes(model)
    (folder / RESULT).write_text(json.dumps(result), encoding="utf-8")


if __name__ == "__main__":
    main(Path(), tuple(sys.argv[1:]))
