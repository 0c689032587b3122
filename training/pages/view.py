"""A page of a folder of results: its recordings, models, diagnoses and agents with their pictures."""

from __future__ import annotations

import base64
import os
import webbrowser
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import numpy as np
import tyro
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape
from pydantic import BaseModel

from acquisition import Ping, Recording, SettingError, SonarError
from acquisition.io.columns import REQUIRED
from acquisition.io.files import is_file, write_text
from acquisition.io.places import OutputFile
from acquisition.io.schema import read_json
from noise import load_model
from training.agents.zoo.board import success_rate
from training.common.canvas import AFTER, BEFORE, Axes, panels
from training.recordings.figures import readings

TEMPLATES = Path(__file__).parent / "templates"
MARK = b": results of sonar_gym</title>"  # by which a page of this command is known
MAX_DEPTH, MAX_ITEMS = 5, 200  # levels of folders that are searched, and results on a page
MAX_BYTES = 50_000_000  # of a recording that is drawn
MODEL = "model.zip"  # of an agent of the zoo
PICTURES = (".png", ".gif", ".svg")
ANGLES_DEG = ((0.0, AFTER), (20.0, BEFORE))  # bearings at which the credence of a model is drawn
KINDS = ("Pictures", "Diagnoses", "Recordings", "Models", "Agents")


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym view`."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of results, for example run/ or demo/."""
    out: OutputFile | None = None
    """Page to write; index.html in the folder by default."""
    open: bool = False
    """Open the page in the browser."""


@dataclass(frozen=True)
class Item:
    """A result on the page.

    Attributes:
        name: path below the folder.
        text: what it is, in a sentence or two.
        links: label -> path relative to the page.
        pictures: sources of images, each with its description.
    """

    name: str
    text: str
    links: dict[str, str] = field(default_factory=dict)
    pictures: list[tuple[str, str]] = field(default_factory=list)


class _Verdict(BaseModel):
    """What is shown of a verdict; other fields are left out."""

    verdict: str
    summary: str


class _Result(BaseModel):
    """What is shown of an agent of the zoo."""

    algorithm: str
    env: str
    sonar: str
    episodes: int
    share: float


class _Kind(BaseModel):
    """What is shown of a model."""

    kind: str


def main(args: Args) -> None:
    """Write the page and print its path."""
    if not args.folder.is_dir():
        raise SettingError(f"{args.folder}: is not a folder; give one that holds results, such as demo/")
    path = args.out or args.folder / "index.html"
    if args.out is None and is_file(path) and MARK not in path.read_bytes():
        raise SettingError(f"{path}: exists already and is no page of `sonar-gym view`; give another file with --out")
    write_text(path, page(args.folder, path.parent))
    print(path)
    if args.open:
        webbrowser.open(path.resolve().as_uri())


def page(folder: Path, base: Path) -> str:
    """Return the page of a folder as HTML; `base` is the folder of the page, to which links are relative."""
    groups: dict[str, list[Item]] = {kind: [] for kind in KINDS}
    groups["Pictures"] = [Item(name, "", pictures=[(link, name)]) for link, name in _beside(folder, base)]
    for path in sorted(_files(folder))[:MAX_ITEMS]:
        kind, describe = _kind_of(path)
        if describe is not None:
            groups[kind].append(_item(path, folder, base, describe))
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=select_autoescape(), undefined=StrictUndefined, trim_blocks=True
    )
    name = folder.resolve().name
    return environment.get_template("view.html").render(folder=name, groups={k: v for k, v in groups.items() if v})


def _files(folder: Path) -> Iterator[Path]:
    for place, folders, names in os.walk(folder):
        depth = len(Path(place).relative_to(folder).parts)
        folders[:] = [name for name in folders if not name.startswith(".") and depth < MAX_DEPTH]
        yield from (Path(place) / name for name in names if _kind_of(Path(place) / name)[1] is not None)


Describe = Callable[[Path, Path], Item]


def _kind_of(path: Path) -> tuple[str, Describe | None]:
    if path.suffix == ".csv" and _has_columns(path):
        return "Recordings", _recording
    found: dict[str, tuple[str, Describe]] = {
        "verdict.json": ("Diagnoses", _diagnosis),
        "model.json": ("Models", _model),
        "agent.json": ("Agents", _agent),
        "result.json": ("Agents", _of_zoo),
    }
    if path.name == "result.json" and not path.with_name(MODEL).exists():  # of another program
        return "", None
    return found.get(path.name, ("", None))


def _has_columns(path: Path) -> bool:
    if not is_file(path):  # a pipe would block
        return False
    try:
        with path.open("rb") as file:
            head = file.readline(100_000).decode("utf-8", "replace").strip().split(",")
    except OSError:
        return True  # the page says why it cannot be read
    return set(REQUIRED) <= set(head)


def _item(path: Path, folder: Path, base: Path, describe: Describe) -> Item:
    """Return a result with its name; one that cannot be read says why."""
    try:
        item = describe(path, base)
    except (SonarError, OSError, ValueError, KeyError) as error:
        item = Item("", f"cannot be read: {error}")
    shown = path if path.suffix == ".csv" else path.parent
    return Item(str(shown.relative_to(folder)), item.text, item.links, item.pictures)


def _link(path: Path, base: Path) -> str:
    return quote(os.fsencode(os.path.relpath(path, base)))


def _beside(folder: Path, base: Path) -> list[tuple[str, str]]:
    """Return the pictures in a folder."""
    return [(_link(path, base), path.stem) for path in sorted(folder.iterdir()) if path.suffix in PICTURES]


def _drawn(picture: bytes, description: str) -> tuple[str, str]:
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}", description


def _recording(path: Path, base: Path) -> Item:
    links = {"CSV": _link(path, base)}
    if path.stat().st_size > MAX_BYTES:
        return Item("", f"more than {MAX_BYTES // 1_000_000} MB: `sonar-gym plot` draws it", links)
    recording = Recording.load(path)
    text = recording.summary().removeprefix(f"{path}: ")
    return Item("", text, links, [_drawn(readings(recording, columns=1), "readings over true distance")])


def _model(path: Path, base: Path) -> Item:
    kind = read_json(path, _Kind)["kind"]
    card = path.parent / "README.md"
    links = {"model.json": _link(path, base)} | ({"card": _link(card, base)} if card.exists() else {})
    pictures = [_drawn(_credence(path.parent), "credence over true distance"), *_beside(path.parent, base)]
    return Item("", f"model of kind {kind}; use it as sonar={str(path.parent)!r}", links, pictures)


def _credence(folder: Path) -> bytes:
    model, distance = load_model(folder), np.linspace(0.05, 6.0, 200)

    def draw(axes: Axes) -> None:
        for angle, colour in ANGLES_DEG:
            ping = Ping.of(distance=distance, angle=np.radians(angle), incidence=0.0, reflectance=0.9)
            axes.plot(distance, model.law(ping).credence(), color=colour, label=f"bearing {angle:g}°")
        axes.set(xlabel="true distance (m)", ylabel="credence, given the condition", ylim=(-0.03, 1.05))
        axes.legend(loc="best")

    return panels([draw], (5.4, 3.2))


def _diagnosis(path: Path, base: Path) -> Item:
    verdict = read_json(path, _Verdict)
    report = path.parent / "report.html"
    links = {"verdict.json": _link(path, base)} | ({"report": _link(report, base)} if report.exists() else {})
    return Item("", f"{verdict['verdict'].replace('_', ' ')}: {verdict['summary']}", links, _beside(path.parent, base))


def _agent(path: Path, base: Path) -> Item:
    card = path.parent / "README.md"
    links = {"agent.json": _link(path, base)} | ({"card": _link(card, base)} if card.exists() else {})
    pictures = _beside(path.parent, base) + _beside(path.parent.parent, base)
    return Item("", f"parking agent; use it with sonar_gym.load_agent({str(path.parent)!r})", links, pictures)


def _of_zoo(path: Path, base: Path) -> Item:
    result = read_json(path, _Result)
    links = {name: _link(path.with_name(name), base) for name in (MODEL, "README.md") if path.with_name(name).exists()}
    text = (
        f"{result['algorithm']} of the zoo, {result['env']} with sonar {result['sonar']}: "
        f"parked in {result['share']:.1%} of {result['episodes']} unseen streets"
    )
    return Item("", text, links, [_drawn(_learning(path.parent), "share of episodes parked during training")])


def _learning(folder: Path) -> bytes:
    steps, rates = success_rate(folder)

    def draw(axes: Axes) -> None:
        axes.plot(steps / 1e6, 100.0 * rates, color=AFTER)
        axes.set(xlabel="million steps", ylabel="parked (%)", ylim=(-2.0, 102.0))

    return panels([draw], (5.4, 3.2))
