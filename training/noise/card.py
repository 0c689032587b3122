"""What is told of a trained model: scores for the terminal, for model.json, and its card."""

from __future__ import annotations

import math
from pathlib import Path
from string import Template
from typing import Any

from rich.table import Table

from acquisition import Recording
from noise.learned.networks import MlpModel
from noise.learned.recurrent import LstmModel
from noise.metrics import Evaluation
from training.noise.networks import LONGEST

CARD = Path(__file__).parent / "templates" / "model_card.md"
HEADINGS = ("model", "log-likelihood, nats a ping", "CRPS, mm", "credence gap")


def rows(scores: dict[str, Evaluation]) -> list[tuple[str, ...]]:
    """Return a row of text for each model: name, log-likelihood, CRPS, credence gap."""
    return [(k, str(s.log_likelihood), str(s.crps_mm), f"{s.credence_gap:.3f}") for k, s in scores.items()]


def table(scores: dict[str, Evaluation], unit: str) -> Table:
    """Return the scores as a table for the terminal."""
    first = next(iter(scores.values())).log_likelihood
    out = Table(title=f"{first.pings} pings in {first.clusters} held-out {unit}, standard errors over these")
    for heading in HEADINGS:
        out.add_column(heading, justify="left" if heading == "model" else "right")
    for row in rows(scores):
        out.add_row(*row)
    return out


def plain(scores: dict[str, Evaluation]) -> dict[str, Any]:
    """Return scores as numbers for model.json, where minus infinity becomes null."""
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
    """Return what kind of network it is, and its widths."""
    sizes = " - ".join(map(str, model.sizes))
    if isinstance(model, MlpModel):
        return f"a perceptron ({sizes})"
    lstm = f"an LSTM over the pings of each run (state of {model.cell.hidden}) and a perceptron ({sizes})"
    return lstm if model.base is None else f"{lstm}, which correct a perceptron without memory,"


def _memory(model: MlpModel | LstmModel) -> str:
    """Return what it does not know of the past."""
    if isinstance(model, MlpModel):
        return "The law knows nothing of time or of the previous reading, nor of"
    return (
        f"The law remembers what one sensor reads in one run, learned on {LONGEST} pings at most; it knows nothing of"
    )


def card(
    name: str,
    model: MlpModel | LstmModel,
    scores: dict[str, Evaluation],
    unit: str,
    recording: Recording,
    commands: list[str],
    note: str = "",
) -> str:
    """Return the card of a model, in Markdown.

    Args:
        name: of the model.
        model: that was trained.
        scores: on what was held out, by model.
        unit: what was held out whole: "conditions".
        recording: that it learned from.
        commands: that make it again, in order.
        note: on the data: what was in front of the sensor, where.
    """
    inputs, tested = model.inputs, next(iter(scores.values())).log_likelihood
    learned = zip(inputs.names, inputs.low, inputs.high, strict=True)
    return Template(CARD.read_text(encoding="utf-8")).substitute(
        name=name,
        network=_network(model),
        memory=_memory(model),
        near=model.head.near,
        fixed=model.head.fixed,
        recording=recording.name if " and " in recording.name else Path(recording.name).name,
        pings=len(recording),
        cells=int(recording.condition.max()) + 1,
        step=f"{1e3 * model.resolution:g}",
        no_answer=f"{model.head.no_answer:.3g}",
        note=note,
        unit=unit,
        commands="\n".join(f"    {line}" for line in commands),
        tested=tested.pings,
        tested_cells=tested.clusters,
        scores="\n".join(f"| {' | '.join(row)} |" for row in rows(scores)),
        learned="\n".join(f"| `{n}` | {low:.4g} | {high:.4g} |" for n, low, high in learned),
        tied=" Incidence always equalled bearing here, so other incidences count as outside." if inputs.tied else "",
    )
