"""The examples run unchanged."""

import runpy
import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


READING_LINES = {
    "make_and_step.py": 5,
    "wrap_your_own.py": 5,
    "wrap_range_array.py": 5,
    "wrap_highway.py": 8,
    "own_layout.py": 5,
}


def printed(name, capsys):
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return capsys.readouterr().out.splitlines()


@pytest.mark.parametrize(("name", "count"), READING_LINES.items())
def test_example_prints_readings_and_true_distances(name, count, capsys):
    lines = [line for line in printed(name, capsys) if "read" in line]
    assert len(lines) == count
    assert all("true" in line for line in lines)


def test_foam_is_detected_less_often_than_steel(capsys):
    detected = {
        line.split(":")[0]: int(line.split(":")[1].split("%")[0]) for line in printed("own_materials.py", capsys)
    }
    assert detected["foam"] < detected["cardboard"] <= detected["ribbed steel"]


def test_sonars_of_the_layout_example_alternate(capsys):
    lines = printed("own_layout.py", capsys)
    ages = [[int(part.split(" ms")[0].split()[-1]) for part in line.split(";")[:3]] for line in lines]
    # the nose pings 20 ms before each observation; after the first step the other readings are those of the reset, and
    # later ones arrive 25 ms after every second observation
    assert ages == [[20, 100, 100], [20, 200, 100], [20, 100, 200], [20, 200, 100], [20, 100, 200]]


def test_every_example_is_tested():
    tested = {*READING_LINES, "own_materials.py", "record_gif.py", "train_highway.py", "ppo.py", "offline.py"}
    assert {path.name for path in EXAMPLES.glob("*.py")} == tested


def test_gif_is_complete(tmp_path, monkeypatch, capsys):
    path = tmp_path / "parking.gif"
    monkeypatch.setattr(sys, "argv", ["record_gif.py", str(path)])
    runpy.run_path(str(EXAMPLES / "record_gif.py"))["main"](str(path), every=20)
    assert "parked: True" in capsys.readouterr().out
    assert iio.imread(path).shape[1:3] == (660, 1000)
    assert [p.name for p in tmp_path.iterdir()] == ["parking.gif"]


def test_an_image_is_one_of_the_episode(tmp_path, capsys):
    path = tmp_path / "parking.png"
    runpy.run_path(str(EXAMPLES / "record_gif.py"))["main"](str(path), every=20)
    assert iio.imread(path).shape == (660, 1000, 3)
    assert [p.name for p in tmp_path.iterdir()] == ["parking.png"]


def test_highway_example_trains_all_arms_and_draws_them(tmp_path, capsys):
    path = tmp_path / "highway.png"
    results = runpy.run_path(str(EXAMPLES / "train_highway.py"))["main"](100, 1, 2, str(path))
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()] == list(results)
    assert iio.imread(path).ndim == 3
    for one in (one for each in results.values() for one in each):
        assert one.steps[-1] <= 100
        assert len(one.returns) == len(one.steps)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_car_with_a_sonar_follows_the_traffic_better_than_one_without():
    results = runpy.run_path(str(EXAMPLES / "train_highway.py"))["main"](seeds=2)
    without, *others = (np.mean([one.tested[:, 0].mean() for one in each]) for each in results.values())
    assert min(others) > max(without, 20.0)  # 20 is the return of the lowest speed


def test_ppo_example_trains_and_counts_unseen_streets(capsys):
    share = runpy.run_path(str(EXAMPLES / "ppo.py"))["main"](steps=8192, streets=8)
    assert capsys.readouterr().out.startswith(f"seed 0: parked in {share:.1%} of 8 unseen streets")


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_plain_ppo_parks_in_nine_of_ten_unseen_streets():
    assert runpy.run_path(str(EXAMPLES / "ppo.py"))["main"]() >= 0.9
