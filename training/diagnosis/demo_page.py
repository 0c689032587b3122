"""Film and self-contained page of the demonstration."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from acquisition.io.files import write_bytes, write_text
from noise.discrepancy.result import Diagnosis
from sonar_gym.parking.drawing import credence_colour
from training.diagnosis.drive import Drive
from training.diagnosis.envelope import Envelope
from training.diagnosis.report import fill

WIDTH, COLUMNS, GAP = 480, 2, 10  # of a film: px, films in a row, px between them
SCENE = (0.08, 0.735)  # top and bottom of the street, as shares of the height
FRAME_MS, LAST_MS = 160, 2500
INK, PAPER = (29, 39, 51), (247, 246, 241)
TITLE, LEGEND, LEGEND_BAR = 30, 34, 120  # px
CORRECTED = "corrected"  # name of the sonar that the diagnosis found
OUTCOME = {"parked": (22, 110, 84), "not": (176, 52, 32)}


@dataclass(frozen=True)
class DemoResult:
    """Content of the page."""

    envelope: Envelope
    diagnosis: Diagnosis
    drives: Mapping[str, Drive]
    film: Path
    seed: int


def gif(drives: Mapping[str, Drive], path: Path) -> Path:
    """Write the films of drives side by side, each with its name and outcome, above a legend of credence.

    Args:
        drives: by name of the sonar; a drive that ends earlier ends with a still picture.
        path: GIF file to write.
    """
    length = max(len(drive.frames) for drive in drives.values())
    frames = [_grid({name: _panel(name, drive, k) for name, drive in drives.items()}) for k in range(length)]
    palette = _palette(frames[length // 2])
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    buffer = io.BytesIO()
    durations = [FRAME_MS] * (length - 1) + [LAST_MS]
    small[0].save(buffer, "GIF", save_all=True, append_images=small[1:], duration=durations, loop=0, optimize=True)
    return write_bytes(path, buffer.getvalue())


def _palette(frame: Image.Image) -> Image.Image:
    """Return a picture whose palette has the colours of a frame and, as a gradient, those of credence.

    The colours of a GIF are shared out by area, and the legend is small: it is enlarged here.
    """
    width, height = frame.size
    whole = Image.new("RGB", (width, height + height // 4))
    whole.paste(frame)
    pen = ImageDraw.Draw(whole)
    for x in range(width):
        pen.line([(x, height), (x, whole.height)], credence_colour(x / (width - 1)))
    return whole.quantize(256)


def _grid(panels: Mapping[str, Image.Image]) -> Image.Image:
    width, height = next(iter(panels.values())).size
    rows = -(-len(panels) // COLUMNS)
    whole = Image.new("RGB", (COLUMNS * width + (COLUMNS + 1) * GAP, rows * (height + GAP) + GAP + LEGEND), PAPER)
    for k, panel in enumerate(panels.values()):
        whole.paste(panel, (GAP + (k % COLUMNS) * (width + GAP), GAP + (k // COLUMNS) * (height + GAP)))
    _legend(whole, whole.height - LEGEND)
    return whole


def _panel(name: str, drive: Drive, k: int) -> Image.Image:
    """Return picture k of a drive below its name and, once it has ended, its outcome."""
    picture, over = drive.frames[min(k, len(drive.frames) - 1)], k >= len(drive.frames) - 1
    top, bottom = (round(share * picture.shape[0]) for share in SCENE)
    scene = Image.fromarray(picture[top:bottom])
    scene = scene.resize((WIDTH, round(WIDTH * scene.height / scene.width)), Image.Resampling.LANCZOS)
    panel = Image.new("RGB", (WIDTH, scene.height + TITLE), PAPER)
    panel.paste(scene, (0, TITLE))
    pen, font = ImageDraw.Draw(panel), ImageFont.load_default(19)
    pen.text((4, 4), f"sonar: {name}", INK, font)
    if over:
        pen.text((WIDTH - 4, 4), drive.end, OUTCOME["parked" if drive.success else "not"], font, anchor="ra")
    return panel


def _legend(whole: Image.Image, top: int) -> None:
    """Draw the colours of credence, and what rings and dots are."""
    pen, font = ImageDraw.Draw(whole), ImageFont.load_default(17)
    pen.text((GAP, top + 6), "cones and rings: readings, by credence   0", INK, font)
    left = GAP + round(pen.textlength("cones and rings: readings, by credence   0 ", font))
    for x in range(LEGEND_BAR):
        pen.line([(left + x, top + 8), (left + x, top + 26)], credence_colour(x / (LEGEND_BAR - 1)))
    pen.text((left + LEGEND_BAR + 6, top + 6), "1", INK, font)
    pen.text((whole.width - GAP, top + 6), "white dots: the truth", INK, font, anchor="ra")


def reason(drive: Drive, diagnosis: Diagnosis) -> str:
    """Return why a drive with the corrected model did not park, as one sentence; empty if it parked."""
    if drive.success:
        return ""
    causes = [cause.statement for cause in diagnosis.verdict.causes if cause.believed]
    found = " ".join(causes) or "The recorded sonar differs from the simulated one."
    return (
        f"{found} The corrected model reads like the recorded sonar, and the driver was made for one without this "
        "error: the car would fail on the street, too. The simulation shows it first."
    )


def render(result: DemoResult, path: Path) -> Path:
    """Write the page with verdict, figures and film as one file."""
    film = base64.b64encode(result.film.read_bytes()).decode()
    text = fill(
        "demo.html",
        result.diagnosis,
        envelope=result.envelope,
        drives=result.drives,
        reasons={name: reason(drive, result.diagnosis) for name, drive in result.drives.items() if name == CORRECTED},
        film=film,
        street=result.seed,
    )
    return write_text(path, text)
