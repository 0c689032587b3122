"""The examples run as they stand."""

import runpy
import sys
from pathlib import Path

import imageio.v3 as iio
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize("name", ["make_and_step.py", "wrap_your_own.py"])
def test_example_prints_what_was_said_and_what_is_true(name, capsys):
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    lines = [line for line in capsys.readouterr().out.splitlines() if "said" in line]
    assert len(lines) == 5
    assert all("true" in line for line in lines)


def test_gif_is_written_whole(tmp_path, monkeypatch, capsys):
    path = tmp_path / "parking.gif"
    monkeypatch.setattr(sys, "argv", ["record_gif.py", str(path)])
    runpy.run_path(str(EXAMPLES / "record_gif.py"))["main"](str(path), every=20)
    assert "parked: True" in capsys.readouterr().out
    assert iio.imread(path).shape[1:3] == (660, 1000)
    assert [p.name for p in tmp_path.iterdir()] == ["parking.gif"]


@pytest.mark.slow
def test_an_agent_learns_on_highway_env_with_sonars():
    before, after = runpy.run_path(str(EXAMPLES / "train_highway.py"))["main"](3000)
    won = after - before
    assert won.mean() > 2.0 * won.std(ddof=1) / len(won) ** 0.5
