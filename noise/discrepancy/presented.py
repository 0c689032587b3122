"""Text, tables, figures and files of a diagnosis, as methods of `Diagnosis`.

Modules are imported on first use and by name: words need the classes of the result, and figures need matplotlib, which
this package does not require.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

from acquisition.arguments import checked
from acquisition.brief import shortened
from acquisition.extras import FigureLike, load_extra
from acquisition.io.files import check_path, write_text
from acquisition.limits import Seed
from noise.store import save_model

REPORT = "noise.discrepancy.report."
FIGURES = "training.diagnosis."


class Presented:
    """Presentation of a `Diagnosis`; notebooks show `_repr_html_`."""

    verdict: Any
    corrected: Any

    def __repr__(self) -> str:
        return shortened(str(load_extra(REPORT + "words", "noise").one_line(self)))

    def _repr_html_(self) -> str:
        return str(load_extra(REPORT + "markup", "noise").compact(self))

    def summary(self) -> str:
        """Return the verdict as about ten lines of text."""
        return "\n".join(load_extra(REPORT + "words", "noise").summary_lines(self))

    def plot(self) -> FigureLike:
        """Return a matplotlib figure: mismatch where it was located, histogram of errors, and scores.

        Raises:
            MissingExtraError: matplotlib is not installed.
        """
        figure: FigureLike = load_extra(FIGURES + "figures", "train").overview(self)
        return figure

    @checked
    def report(self, path: str | os.PathLike[str], seed: Seed = 0) -> Path:
        """Write the HTML report and return its path.

        Args:
            path: file to write.
            seed: seed of randomised figures.

        Raises:
            MissingExtraError: matplotlib or jinja2 is not installed.
        """
        path = Path(path)
        return write_text(
            path, load_extra(FIGURES + "report", "train").render(self, str(path.parent / "corrected"), seed)
        )

    @checked
    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write verdict.json and, if a correction is offered, the model in corrected/; return the folder."""
        folder = Path(folder)
        check_path(folder, "folder")
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "verdict.json", json.dumps(self.verdict.to_dict(), indent=1, allow_nan=False) + "\n")
        corrected = folder / "corrected"
        if self.corrected is not None:
            save_model(self.corrected, corrected)
        elif (corrected / "model.json").is_file():  # of an earlier diagnosis, which must not be taken for this one's
            shutil.rmtree(corrected)
        return folder
