"""Scores of a trained model for the terminal and for model.json, and its model card."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from rich.table import Table

from acquisition import Recording
from noise.learned.inputs import COMPARED_C, Inputs
from noise.learned.networks import MlpModel
from noise.learned.recurrent import LstmModel
from noise.metrics import Evaluation
from training.common.tables import markdown_table
from training.noise.conditions import Calibration
from training.noise.networks import MAX_RUN_PINGS

CARD = Path(__file__).parent / "templates" / "model_card.md"
RESCALED = (
    f" At other temperatures from {COMPARED_C[0]:g} to {COMPARED_C[1]:g} degC the law is that of equal "
    "time of flight at the end of the range."
)
BY_LOSS = (
    " A gain enters as the loss of the echo that it causes, `gain_loss_db`; a ping without a gain is at that of "
    "power-up."
)
CALIBRATED = (
    "Simulated by the waveform rig. Credence is that given the condition and, with memory, the earlier readings;\n"
    "standard errors are over sensors. The calibration error is the mean gap over tenths of credence."
)
COLUMNS = ("condition", "within 10 %", "credence - frequency", "calibration error", "marked by `law.extrapolates`")
HEADINGS = ("model", "log-likelihood, nats per ping", "CRPS, mm", "credence gap")


def score_rows(scores: dict[str, Evaluation]) -> list[tuple[str, ...]]:
    """Return a row of text for each model: name, log-likelihood, CRPS, credence gap."""
    return [(k, str(s.log_likelihood), str(s.crps_mm), f"{s.credence_gap:.3f}") for k, s in scores.items()]


def score_table(scores: dict[str, Evaluation], unit: str) -> Table:
    """Return the scores as a table for the terminal."""
    first = next(iter(scores.values())).log_likelihood
    out = Table(title=f"{first.pings} pings in {first.clusters} test {unit}, standard errors over these")
    for heading in HEADINGS:
        out.add_column(heading, justify="left" if heading == "model" else "right")
    for row in score_rows(scores):
        out.add_row(*row)
    return out


def scores_as_numbers(scores: dict[str, Evaluation]) -> dict[str, Any]:
    """Return scores as numbers for model.json; infinite values become null."""
    return {
        name: {
            "log_likelihood_per_ping": _finite(s.log_likelihood.mean),
            "log_likelihood_error": _finite(s.log_likelihood.error),
            "crps_mm": _finite(s.crps_mm.mean),
            "crps_mm_error": _finite(s.crps_mm.error),
            "credence_gap": _finite(s.credence_gap),
        }
        for name, s in scores.items()
    }


def _finite(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def _network(model: MlpModel | LstmModel) -> str:
    """Return the type of the network and its layer widths."""
    sizes = " - ".join(map(str, model.sizes))
    if isinstance(model, MlpModel):
        return f"a perceptron ({sizes})"
    lstm = f"an LSTM over the pings of each run (state of {model.cell.hidden}) and a perceptron ({sizes})"
    return lstm if model.base is None else f"{lstm} that correct a perceptron without memory,"


def _memory(model: MlpModel | LstmModel) -> str:
    """Return the start of the sentence on the limits of the law's memory."""
    if isinstance(model, MlpModel):
        return "The law depends neither on time nor on previous readings, and does not cover"
    return f"The law depends on previous readings of the run (trained on at most {MAX_RUN_PINGS}) and does not cover"


def _fixed(inputs: Inputs) -> str:
    """Return the sentence on covariates that had one value in the training data."""
    values = ", ".join(f"`{name}` {value:g}" for name, value in inputs.fixed.items())
    return f"\nThe training data have one value only of {values}.\n" if values else ""


def _persistence(model: MlpModel | LstmModel) -> str:
    """Return the sentence on the part of the spread that persists from ping to ping."""
    kept = getattr(model, "persistence", None)
    if kept is None:
        return ""
    return f" Of the spread, {kept.detection:.0%} (detection) and {kept.range:.0%} (range) persist within a visit."


def _calibration(conditions: Mapping[str, Calibration]) -> str:
    """Return the section on calibration by condition."""
    if not conditions:
        return ""
    rows = [
        (name, str(c.right), str(c.gap), f"{c.error:.3f}", f"{c.extrapolates:.0%}") for name, c in conditions.items()
    ]
    return f"\n## Calibration on new sensors, by condition\n\n{CALIBRATED}\n\n{markdown_table(COLUMNS, rows)}\n"


def card(
    name: str,
    model: MlpModel | LstmModel,
    scores: dict[str, Evaluation],
    unit: str,
    recording: Recording,
    commands: list[str],
    note: str = "",
    conditions: Mapping[str, Calibration] | None = None,
) -> str:
    """Return the card of a model, in Markdown.

    Args:
        name: of the model.
        model: the trained model.
        scores: on the test data, by model.
        unit: what the test data are split by: "conditions".
        recording: training data.
        commands: that make the model, in order.
        note: on the data: what was in front of the sensor, where.
        conditions: calibration on new sensors by condition.
    """
    inputs, tested = model.inputs, next(iter(scores.values())).log_likelihood
    limits = zip(inputs.names, inputs.low, inputs.high, strict=True)
    ranges = [(f"`{quantity}`", f"{low:.4g}", f"{high:.4g}") for quantity, low, high in limits]
    return Template(CARD.read_text(encoding="utf-8")).substitute(
        name=name,
        network=_network(model),
        memory=_memory(model),
        near=model.head.near,
        fixed=model.head.fixed,
        recording=recording.name if " and " in recording.name else Path(recording.name).name,
        pings=len(recording),
        conditions=int(recording.condition.max()) + 1,
        step=f"{1e3 * model.resolution:g}",
        no_answer=f"{np.mean(~recording.reading.answered):.3g}",
        note=note,
        unit=unit,
        commands="\n".join(f"    {line}" for line in commands),
        tested=tested.pings,
        tested_conditions=tested.clusters,
        scores=markdown_table(HEADINGS, score_rows(scores)),
        ranges=markdown_table(("quantity", "from", "to"), ranges),
        single_valued=_fixed(inputs),
        temperatures=(RESCALED if inputs.uncompensated else "") + (BY_LOSS if inputs.by_loss else ""),
        persistence=_persistence(model),
        calibration=_calibration(conditions or {}),
        tied=" Incidence equals bearing in the data, so other incidences count as outside." if inputs.tied else "",
    )
