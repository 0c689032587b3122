"""The catalogue's page is the catalogue."""

from pathlib import Path

from noise.effects import CATALOGUE
from training.diagnosis.effects import page


def test_the_page_in_the_docs_is_the_one_that_the_command_makes():
    assert (Path(__file__).parents[3] / "docs" / "catalogue.md").read_text(encoding="utf-8") == page()


def test_every_effect_and_parameter_is_on_the_page():
    text = page()
    for name, effect in CATALOGUE.items():
        assert f"### `{name}`" in text
        assert all(f"| `{p.name}` | {p.unit} |" in text for p in effect.parameters)
