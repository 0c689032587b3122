"""The command `sonar-gym effects`."""

import pytest

from noise.effects import CATALOGUE
from training.cli import main


@pytest.mark.parametrize("to_file", [False, True], ids=["printed", "written"])
def test_every_effect_is_listed_with_parameters_units_and_bounds(to_file, tmp_path, capsys):
    main(["effects", *(["--out", str(tmp_path / "effects.md")] if to_file else [])])
    text = (tmp_path / "effects.md").read_text(encoding="utf-8") if to_file else capsys.readouterr().out
    for name, effect in CATALOGUE.items():
        assert f"### `{name}`" in text
        for p in effect.parameters:
            assert f"| `{p.name}` | {p.unit} | {p.null:.4g} | {p.low:g} | {p.high:g} | {p.source} |" in text
