"""The page of the demonstration renders with and without a corrected model."""

from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from sonar_gym.control.driver import Episode
from training.diagnosis.demo_page import INK, PAPER, DemoResult, gif, reason, render
from training.diagnosis.drive import Drive
from training.diagnosis.envelope import Envelope


def drive(success, frames=2):
    pictures = [np.full((300, 600, 3), 40 * k, np.uint8) for k in range(frames)]
    return Drive(success, not success, 40, 12.0, 0.1, pictures)


@pytest.mark.parametrize("name", ["scale", "unexplained"])
def test_the_page_shows_diagnosis_and_drives(situations, tmp_path, name):
    made = situations[name]
    one = drive(success=True)
    drives = {"ideal": one, "srf08-mlp": one} | ({"corrected": one} if made.corrected is not None else {})
    envelope = SimpleNamespace(effect="sound_speed", description="air at 14 degC", seal="ab" * 32)
    film = tmp_path / "parking.gif"
    film.write_bytes(b"GIF89a")
    page = render(DemoResult(envelope, made, drives, film, 12), tmp_path / "report.html").read_text()
    assert made.verdict.summary in page.replace("&#39;", "'")
    assert page.count("<td>parked</td>") == len(drives)
    assert f"One street, {len(drives)} drives" in page
    assert ("loads the corrected model" in page) == (made.corrected is not None)
    assert "<svg" in page


def test_a_failure_of_the_corrected_model_comes_with_its_reason(situations, tmp_path):
    made, film = situations["scale"], tmp_path / "parking.gif"
    film.write_bytes(b"GIF89a")
    drives = {"ideal": drive(success=True), "corrected": drive(success=False)}
    envelope = SimpleNamespace(effect="sound_speed", description="air at 14 degC", seal="ab" * 32)
    page = render(DemoResult(envelope, made, drives, film, 12), tmp_path / "report.html").read_text()
    assert "Why corrected collided." in page
    assert all(cause.statement in reason(drives["corrected"], made) for cause in made.verdict.causes if cause.believed)
    assert reason(drives["ideal"], made) == ""


def test_a_drive_without_an_echo_has_no_median_error():
    far = np.full((3, 2), 4.0)
    episode = Episode(False, False, 2, 0.0, [], far, np.zeros((3, 2)), np.zeros((3, 2)), far)
    assert "median error unknown" in Drive.of(episode).summary


def test_films_are_side_by_side_and_the_shorter_ones_wait(tmp_path):
    drives = {str(k): drive(success=k > 0, frames=k + 2) for k in range(4)}
    with Image.open(gif(drives, tmp_path / "film.gif")) as film:
        assert film.n_frames == 5
        assert film.width > 1.5 * film.height


def test_the_legend_of_a_film_is_a_gradient(tmp_path):
    blue, red = np.meshgrid(np.linspace(60, 255, 600), np.linspace(60, 160, 300))
    picture = np.stack([red, np.full_like(red, 60.0), blue], axis=-1).astype(np.uint8)
    busy = Drive(True, False, 40, 12.0, 0.1, [picture] * 2)
    with Image.open(gif({"ideal": busy, "srf08-mlp": busy}, tmp_path / "film.gif")) as film:
        legend = np.asarray(film.convert("RGB"))[-20, : film.width // 2].astype(np.int64)
    ink, paper = np.array(INK), np.array(PAPER)
    coloured = legend[(np.ptp(legend, axis=1) > np.maximum(np.ptp(ink), np.ptp(paper)))]
    assert len(np.unique(coloured, axis=0)) > 15


def test_the_stand_in_has_the_attributes_of_the_real_class():
    assert {"effect", "description", "seal"} <= {*Envelope.__dataclass_fields__, *dir(Envelope)}
