"""Text, tables, figures and files of a diagnosis, as methods of `Diagnosis`.

Modules are imported on first use and by name: words need the classes of the result, and figures need matplotlib, which
this package does not require.
"""

from __future__ import annotations

import json
import os
import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import Recording, SettingError
from acquisition.arguments import checked
from acquisition.brief import shortened
from acquisition.extras import FigureLike, load_extra
from acquisition.io.files import check_path, write_text
from acquisition.io.given import RecordingLike, as_recording
from acquisition.limits import Seed
from noise.replay import corrected_readings
from noise.store import save_model

REPORT = "noise.discrepancy.report."
FIGURES = "training.diagnosis."


class Presented:
    """Presentation of a `Diagnosis`; notebooks show `_repr_html_`."""

    verdict: Any
    corrected: Any
    difference: Any
    left_out: Any

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
    def correct(self, simulated: RecordingLike, seed: Seed = 0) -> Recording:
        """Return the readings of the simulator with what differs applied to them; what cannot be is warned of.

        Args:
            simulated: readings of the simulator: a `Recording`, a table with its columns, or the path of a CSV file.
            seed: of the draws.

        Raises:
            SettingError: nothing was found that can be applied.
        """
        if self.difference is None:
            raise SettingError(
                f"Diagnosis.correct: the verdict is {self.verdict.verdict}, and nothing was found that can be applied "
                "to the simulator's readings"
            )
        if self.left_out:
            reasons = "; ".join(f"{name} ({reason})" for name, reason in self.left_out.items())
            warnings.warn(f"correct: not applied: {reasons}", stacklevel=2)
        return corrected_readings(self.difference, as_recording(simulated, "simulation"), np.random.default_rng(seed))

    @checked
    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write verdict.json, and the models where there are any; return the folder.

        The corrected model is in corrected/, what acts on the simulator's own readings in difference/.
        """
        folder = Path(folder)
        check_path(folder, "folder")
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "verdict.json", json.dumps(self.verdict.to_dict(), indent=1, allow_nan=False) + "\n")
        for name, model in (("corrected", self.corrected), ("difference", self.difference)):
            if model is not None:
                save_model(model, folder / name)
            elif (folder / name / "model.json").is_file():  # of an earlier diagnosis, not to be taken for this one's
                shutil.rmtree(folder / name)
        return folder
