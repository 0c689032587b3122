"""Film and self-contained page of the demonstration."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from acquisition.io.files import write_bytes, write_text
from noise.discrepancy.result import Diagnosis
from training.diagnosis.drive import Drive
from training.diagnosis.envelope import Envelope
from training.diagnosis.report import fill

Picture = NDArray[np.uint8]
WIDTH = 620  # px, of a film
SCENE = (0.08, 0.735)  # top and bottom of the street, as shares of the height
FRAME_MS, LAST_MS = 160, 2500
INK, PAPER = (29, 39, 51), (247, 246, 241)
TITLE = 26  # px


@dataclass(frozen=True)
class DemoResult:
    """Content of the page."""

    envelope: Envelope
    diagnosis: Diagnosis
    drives: Mapping[str, Drive]
    film: Path
    seed: int


def gif(films: Mapping[str, Sequence[Picture]], path: Path) -> Path:
    """Write films one above the other, each with its name; shorter films end with a still picture.

    Args:
        films: frames of each drive, (height, width, 3) uint8.
        path: GIF file to write.
    """
    length = max(map(len, films.values()))
    frames = [_stack({name: film[min(k, len(film) - 1)] for name, film in films.items()}) for k in range(length)]
    palette = frames[length // 2].quantize(96)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    buffer = io.BytesIO()
    durations = [FRAME_MS] * (length - 1) + [LAST_MS]
    small[0].save(buffer, "GIF", save_all=True, append_images=small[1:], duration=durations, loop=0, optimize=True)
    return write_bytes(path, buffer.getvalue())


def _stack(pictures: Mapping[str, Picture]) -> Image.Image:
    strips = [_strip(name, picture) for name, picture in pictures.items()]
    height = sum(strip.height for strip in strips)
    whole = Image.new("RGB", (WIDTH, height), PAPER)
    for k, strip in enumerate(strips):
        whole.paste(strip, (0, sum(s.height for s in strips[:k])))
    return whole


def _strip(name: str, picture: Picture) -> Image.Image:
    top, bottom = (round(share * picture.shape[0]) for share in SCENE)
    scene = Image.fromarray(picture[top:bottom])
    scene = scene.resize((WIDTH, round(WIDTH * scene.height / scene.width)), Image.Resampling.LANCZOS)
    strip = Image.new("RGB", (WIDTH, scene.height + TITLE), PAPER)
    strip.paste(scene, (0, TITLE))
    ImageDraw.Draw(strip).text((10, 5), f"sonar: {name}", INK, ImageFont.load_default(15))
    return strip


def render(result: DemoResult, path: Path) -> Path:
    """Write the page with verdict, figures and film as one file."""
    film = base64.b64encode(result.film.read_bytes()).decode()
    text = fill(
        "demo.html",
        result.diagnosis,
        envelope=result.envelope,
        drives=result.drives,
        film=film,
        street=result.seed,
    )
    return write_text(path, text)
