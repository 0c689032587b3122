"""Catalogue of effects: a list, or pages with the formula, the parameters and a figure of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from acquisition.io.files import write_bytes, write_text
from acquisition.io.places import OutputFolder
from acquisition.ping import RANGE_RATE
from noise import PhysicalModel, simulate
from noise.effects import CATALOGUE, Effect, Parameter, Stage
from training.common.canvas import AFTER, BEFORE, SOFT, Axes, panels
from training.common.commit import commit
from training.common.progress import bar
from training.common.tables import markdown_table
from training.pages.examples import EXAMPLES, Axis, Example

HEAD = """# Catalogue of effects

Physical effects that the diagnosis can name and `noise.PhysicalModel` can apply. An effect with all parameters at their
null values changes nothing. In formulas, $d$ is the true distance, $s$ half the length of a path, $r$ the range in the
register, $L$ the level above the threshold in dB, $t$ the time, $P$ a probability, $\\theta$ the incidence and $\\beta$
the bearing; primes mark values with the effect. Figures show errors of readings without the effect (orange) and with it
(blue); marks at the bottom are pings without an echo.
"""
PAGES = {
    Stage.CONDITION: ("mounting", "Mounting: geometry of the ping"),
    Stage.PATHS: ("paths", "Paths: propagation of the sound"),
    Stage.MEDIUM: ("medium", "Medium and level: attenuation of every path"),
    Stage.DETECTOR: ("detector", "Detector: detection and timing of arrivals"),
    Stage.REGISTER: ("register", "Register: clock, unit, range limit"),
    Stage.SEQUENCE: ("link", "Link: replacement of readings"),
}
AXES: dict[Axis, tuple[Floats, str]] = {
    "distance": (np.linspace(0.2, 6.0, 240), "true distance (mm)"),
    "angle": (np.radians(np.linspace(-45.0, 45.0, 240)), "bearing (deg)"),
    "reflectance": (np.linspace(0.02, 1.0, 240), "reflectance"),
    "time": (np.linspace(0.0, 3600.0, 240), "time (s)"),
}
AT_M = 2.0  # distance of the reflector where another condition varies
SHOWN = {"distance": 1000.0, "angle": 180.0 / np.pi, "reflectance": 1.0, "time": 1.0}  # axis -> factor to its unit
MM = 1000.0
MIN_MM = 10.0  # least limit of the axis of errors, so that the steps of the register do not fill it


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym effects`."""

    out: OutputFolder | None = None
    """Folder for the pages and their figures; by default a list of the effects is printed."""


def main(args: Args) -> None:
    """Print the list of effects, or write the pages."""
    if args.out is None:
        print("\n".join(f"{name:<24}{effect.summary}" for name, effect in CATALOGUE.items()))
        return
    pages = {"index": index(), **{name: page(stage) for stage, (name, _) in PAGES.items()}}
    for name, text in pages.items():
        write_text(args.out / f"{name}.md", text)
    with bar("drawing", len(CATALOGUE)) as progress:
        for k, name in enumerate(CATALOGUE):
            write_bytes(args.out / "images" / f"{name}.png", picture(name))
            progress(k + 1, len(CATALOGUE))


def index() -> str:
    """Return the page that lists all effects by stage."""
    rows = [
        [f"[{PAGES[stage][1]}]({PAGES[stage][0]}.md)", ", ".join(_link(stage, effect.name) for effect in _of(stage))]
        for stage in Stage
    ]
    return "\n".join([HEAD, f"{_made()}\n", markdown_table(["stage", "effects"], rows), ""])


def _made() -> str:
    return f"Made by `sonar-gym effects --out docs/reference/effects` at commit {commit()}."


def _link(stage: Stage, name: str) -> str:
    return f"[`{name}`]({PAGES[stage][0]}.md#{name})"


def page(stage: Stage) -> str:
    """Return the page of the effects of a stage."""
    return "\n".join([f"# {PAGES[stage][1]}\n", f"{_made()}\n", *map(_entry, _of(stage))])


def _of(stage: Stage) -> list[type[Effect]]:
    return [effect for effect in CATALOGUE.values() if effect.stage == stage]


def _entry(effect: type[Effect]) -> str:
    name, example = effect.name, EXAMPLES[effect.name]
    table = markdown_table(["parameter", "unit", "null", "from", "to", "source"], map(_row, effect.parameters))
    given = ", ".join(f"{key} = {value:g}" for key, value in example.values.items())
    figure = f"![Errors of readings by {example.axis}, without and with {name}](images/{name}.png)"
    text = (effect.__doc__ or "").split("\n\n")[0].strip()
    return "\n".join(
        [f"## {name}\n", f"{text}\n", f"$$ {example.formula} $$\n", table, f"\n{figure}\n", f"With `{given}`.\n"]
    )


def _row(p: Parameter) -> list[str]:
    return [f"`{p.name}`", p.unit, f"{p.null:.4g}", f"{p.low:g}", f"{p.high:g}", p.source]


def picture(name: str) -> bytes:
    """Return a figure of the errors of readings without and with an effect, PNG."""
    example = EXAMPLES[name]
    beside = [CATALOGUE[other](**values) for other, values in example.beside.items()]
    models = PhysicalModel(beside), PhysicalModel([*beside, CATALOGUE[name](**example.values)])
    return panels([lambda axes: draw(axes, example, *models)], (7.2, 3.2))


def draw(axes: Axes, example: Example, without: PhysicalModel, with_it: PhysicalModel) -> None:
    """Draw the errors of readings of two models."""
    ping, x = ping_of(example)
    axes.axhline(0.0, color=SOFT, linewidth=0.8)
    for k, (model, colour, label) in enumerate(((without, BEFORE, "without"), (with_it, AFTER, "with the effect"))):
        reading = simulate(model, ping, np.random.default_rng(k))
        error = MM * (reading.range - ping.distance)
        axes.plot(x[reading.echo], error[reading.echo], ".", color=colour, markersize=4, label=label)
        _mark_silence(axes, x[~reading.echo], 0.02 + 0.05 * k, colour)
    axes.set(xlabel=AXES[example.axis][1], ylabel="reading − distance (mm)")
    axes.margins(y=0.15)
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -MIN_MM), max(high, MIN_MM))
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)  # above, where no reading is


def _mark_silence(axes: Axes, x: Floats, height: float, colour: str) -> None:
    axes.plot(x, np.full(len(x), height), "|", color=colour, markersize=6, transform=axes.get_xaxis_transform())


def ping_of(example: Example) -> tuple[Ping, Floats]:
    """Return the pings of a figure in random order, with the values of its axis in the unit that is shown."""
    order = np.random.default_rng(0).permutation(len(AXES[example.axis][0]))
    value = AXES[example.axis][0][order if example.axis != "time" else slice(None)]
    conditions: dict[str, Floats | float] = {"distance": AT_M, example.axis: value}
    if example.facing:
        conditions["incidence"] = 0.0
    ping = Ping.of(**conditions, **{RANGE_RATE: 0.5})  # of a car that drives away, which shows latency
    return ping, SHOWN[example.axis] * value
