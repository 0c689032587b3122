"""The command `sonar-gym effects`: the list, and pages with a formula, the parameters and a figure of each effect."""

import numpy as np
import pytest
from latex2mathml.converter import convert

from noise import PhysicalModel, simulate
from noise.effects import CATALOGUE, Stage
from training.cli import main
from training.pages.effects import PAGES, index, page, picture, ping_of
from training.pages.examples import EXAMPLES


def test_every_effect_is_listed(capsys):
    main(["effects"])
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(CATALOGUE)
    assert all(f"#{name})" in index() for name in CATALOGUE)


@pytest.mark.parametrize("stage", Stage, ids=lambda stage: stage.name.lower())
def test_the_pages_state_parameters_units_and_bounds(stage):
    text = page(stage)
    for name, effect in CATALOGUE.items():
        assert (f"## {name}\n" in text) == (effect.stage == stage)
        if effect.stage == stage:
            for p in effect.parameters:
                assert f"| `{p.name}` | {p.unit} | {p.null:.4g} | {p.low:g} | {p.high:g} | {p.source} |" in text


@pytest.mark.parametrize("name", CATALOGUE)
def test_the_example_of_an_effect_changes_readings_and_its_formula_can_be_typeset(name):
    example = EXAMPLES[name]
    assert convert(example.formula).startswith("<math")
    beside = [CATALOGUE[other](**values) for other, values in example.beside.items()]
    ping, _ = ping_of(example)
    without = simulate(PhysicalModel(beside), ping, np.random.default_rng(0))
    with_it = simulate(PhysicalModel([*beside, CATALOGUE[name](**example.values)]), ping, np.random.default_rng(0))
    assert (without.range != with_it.range).mean() > 0.02


def test_a_figure_is_a_picture():
    assert picture("zero_offset")[:4] == b"\x89PNG"


def test_pages_and_figures_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr("training.pages.effects.picture", lambda name: name.encode())
    main(["effects", "--out", str(tmp_path)])
    assert {path.stem for path in tmp_path.glob("*.md")} == {"index", *(name for name, _ in PAGES.values())}
    assert {path.stem for path in (tmp_path / "images").iterdir()} == set(CATALOGUE)
