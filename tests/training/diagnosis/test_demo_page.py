"""The page of the demonstration renders with and without a corrected model."""

from types import SimpleNamespace

import pytest

from training.diagnosis.demo_page import DemoResult, render
from training.diagnosis.drive import Drive
from training.diagnosis.envelope import Envelope


@pytest.mark.parametrize("name", ["scale", "unexplained"])
def test_the_page_shows_diagnosis_and_drives(situations, tmp_path, name):
    made = situations[name]
    one = SimpleNamespace(success=True, collision=False, steps=40, error_mm=12.0, silent=0.1)
    drives = {"ideal": one, "srf08-mlp": one} | ({"corrected": one} if made.corrected is not None else {})
    envelope = SimpleNamespace(effect="sound_speed", description="air at 14 degC", seal="ab" * 32)
    film = tmp_path / "parking.gif"
    film.write_bytes(b"GIF89a")
    page = render(DemoResult(envelope, made, drives, film, 12), tmp_path / "report.html").read_text()
    assert made.verdict.summary in page.replace("&#39;", "'")
    assert page.count("<td>parked</td>") == len(drives)
    assert "<svg" in page


def test_the_stand_ins_have_the_attributes_of_the_real_classes():
    assert {"success", "collision", "steps", "error_mm", "silent"} <= {*Drive.__dataclass_fields__, *dir(Drive)}
    assert {"effect", "description", "seal"} <= {*Envelope.__dataclass_fields__, *dir(Envelope)}
