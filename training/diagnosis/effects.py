"""List the catalogue of effects: what each is, its parameters with units, bounds and sources."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from noise.effects import CATALOGUE, Effect, Parameter, Stage

HEAD = """# The catalogue of effects

Every piece of physics that the diagnosis can name and `PhysicalModel` can apply. With its parameters at their null
values an effect does nothing. Made by `sonar-gym effects --out docs/catalogue.md`.
"""
WHERE = {
    Stage.CONDITION: "Mounting: what the sensor faces",
    Stage.PATHS: "Paths: the ways that sound takes",
    Stage.MEDIUM: "Medium and level: what happens to every path",
    Stage.DETECTOR: "Detector: when and whether an arrival counts",
    Stage.REGISTER: "Registers: clock, unit, gate",
    Stage.SEQUENCE: "Link: what replaces a reading",
}


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym effects`."""

    out: Path | None = None
    """Markdown file to write; printed where none is given."""


def page() -> str:
    """Return the catalogue as Markdown."""
    sections = [_section(stage) for stage in Stage if any(e.stage == stage for e in CATALOGUE.values())]
    return "\n".join([HEAD, *sections])


def _section(stage: Stage) -> str:
    members = [effect for effect in CATALOGUE.values() if effect.stage == stage]
    return "\n".join([f"## {WHERE[stage]}\n", *map(_entry, members)])


def _entry(effect: type[Effect]) -> str:
    formula = (effect.__doc__ or "").strip().splitlines()[0]
    rows = [_row(parameter) for parameter in effect.parameters]
    head = "| parameter | unit | null | from | to | source |\n|---|---|---|---|---|---|"
    return "\n".join([f"### `{effect.name}`\n", f"{effect.summary}. {formula}\n", head, *rows, ""])


def _row(p: Parameter) -> str:
    return f"| `{p.name}` | {p.unit} | {p.null:.4g} | {p.low:g} | {p.high:g} | {p.source} |"


def main(args: Args) -> None:
    """Print or write the catalogue."""
    if args.out is None:
        print(page())
    else:
        args.out.write_text(page(), encoding="utf-8")
