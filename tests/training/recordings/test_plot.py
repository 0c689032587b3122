"""Figures of recordings: levels, surfaces, and figures of every kind of recording."""

import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from acquisition import Ping, Reading, Recording
from training.cli import main
from training.recordings.figures import FIGURES, Levels, Part, parts
from training.recordings.plot import over

rng = np.random.default_rng(0)


def survey(n=600, **columns):
    """Two reflectors on a grid; correct up to 2 m, no echo up to 3 m, then one wire fault in three."""
    distance, angle = rng.choice(np.arange(0.5, 4.1, 0.5), n), rng.choice([0.0, 0.1, 0.2], n)
    range_ = np.where(distance <= 2.0, distance, 0.0)
    status = np.where(range_ > 0, 1, 0)
    status = np.where((distance > 3.0) & (np.arange(n) % 3 == 0), 2, status)
    ping = Ping.of(distance, angle, reflectance=rng.choice([0.1, 0.9], n), **columns)
    return Recording.of(ping, Reading.of(range_, status))


def test_a_surface_is_the_mean_of_each_condition():
    part = parts(survey())[0]
    surface = part.surface(part.right)[::2, ::2]
    distance = (part.distances.low + part.distances.high) / 2
    assert part.title == "reflectance 0.9 (mirror)"
    assert (surface[:, distance < 2.2] == 1.0).all()
    assert (surface[:, distance > 2.2] == 0.0).all()


def test_pings_without_an_answer_are_excluded():
    ping = Ping.of([1.0, 1.0, 2.0], [0.0, 0.0, 0.0])
    part = Part(Recording.of(ping, Reading.of([1.0, 0.0, 0.0], [1, 2, 2])), "")
    assert part.surface(part.right).tolist()[0][0] == 1.0
    assert np.isnan(part.surface(part.right)[0, 2])


def test_a_correct_reading_is_within_ten_percent_of_the_truth():
    ping = Ping.of([1.0] * 5)
    part = Part(Recording.of(ping, Reading.of([0.91, 1.09, 0.89, 1.11, 0.0])), "")
    assert part.right.tolist() == [1, 1, 0, 0, 0]


@settings(max_examples=60)
@given(st.lists(st.floats(0, 10), min_size=1, max_size=80), st.integers(2, 40), st.floats(0.001, 1))
def test_levels_do_not_overlap_and_contain_their_pings(values, max_levels, max_half_width):
    value = np.array(values)
    levels = Levels.of(value, max_levels, max_half_width)
    assert (levels.high >= levels.low).all()
    assert (levels.low[1:] >= levels.high[:-1] - 1e-9).all()
    assert len(levels.low) <= max(max_levels, 1)
    assert (value >= levels.low[levels.index] - 1e-6).all()
    assert (value <= levels.high[levels.index] + 1e-6).all()


RECORDINGS = {
    "grid": survey(),
    "irregular": Recording.of(Ping.of(rng.uniform(0.1, 5, 800), rng.uniform(-0.6, 0.6, 800)), Reading.of([1.0] * 800)),
    "one ping": Recording.of(Ping.of([1.0]), Reading.of([1.0])),
    "one condition": Recording.of(Ping.of([1.0] * 30), Reading.of(rng.normal(1, 0.01, 30))),
    "silent": Recording.of(Ping.of([1.0, 2.0]), Reading.of([0.0, 0.0])),
    "dead": Recording.of(Ping.of([1.0, 2.0]), Reading.of([0.0, 0.0], [2, 2])),
    "at zero": Recording.of(Ping.of([0.0]), Reading.of([0.3])),
    "behind": Recording.of(Ping.of([1.0, 1.0], [-3.1, 3.1]), Reading.of([1.0, 1.0])),
    "warm": survey(temperature_c=rng.uniform(18, 22, 600)),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_every_figure_is_drawn_for_every_recording(tmp_path, capsys, name):
    path = RECORDINGS[name].save(tmp_path / "r.csv")
    main(["plot", str(path), "--out", str(tmp_path / "figures")])
    assert capsys.readouterr().out.count("\n") == len(FIGURES)
    for file in FIGURES:
        with Image.open(tmp_path / "figures" / file) as image:
            assert image.size[0] > 200
            colours = np.asarray(image.convert("L"))
        assert colours.std() > 5  # something is drawn


def test_a_temperature_in_words_is_not_drawn(tmp_path):
    path = survey(temperature_c=18.125).save(tmp_path / "r.csv")
    path.write_text(path.read_text().replace("18.125", "warm", 1))
    main(["plot", str(path), "--out", str(tmp_path / "figures")])
    assert {file.name for file in (tmp_path / "figures").iterdir()} >= {"course.png"}


def test_selected_rows(tmp_path, capsys):
    path = survey(600).save(tmp_path / "r.csv")
    main(["plot", str(path), "--out", str(tmp_path), "--where", "reflectance=0.9", "sensor=0"])
    for wrong in ("reflectance=0.5", "voltage=3", "reflectance"):
        with pytest.raises(SystemExit):
            main(["plot", str(path), "--out", str(tmp_path), "--where", wrong])
        assert f"--where {wrong}: " in capsys.readouterr().err


def test_surfaces_over_another_column(tmp_path, capsys):
    path = survey(pitch_deg=np.repeat([-10.0, 0.0, 10.0], 200)).save(tmp_path / "r.csv")
    tilted = over(Recording.load(path), "pitch_deg")
    assert np.degrees(np.unique(tilted.ping.angle)).tolist() == pytest.approx([-10.0, 0.0, 10.0])
    with pytest.raises(SystemExit):
        main(["plot", str(path), "--out", str(tmp_path), "--bearing", "yaw_deg"])
    assert "--bearing yaw_deg: expected one of angle_deg, pitch_deg" in capsys.readouterr().err


def test_figures_are_reproducible():
    recording = RECORDINGS["grid"]
    assert all(draw(recording) == draw(recording) for draw, _ in FIGURES.values())


def test_nothing_touches_the_edge_of_a_figure(tmp_path):
    """A title, a label or a cell that is cut leaves ink in the outermost pixels."""
    angle = np.deg2rad(np.tile([0.0, 15.0, 30.0, 45.0], 12))
    distance = np.repeat(np.linspace(0.5, 6.0, 12), 4)
    for sides in (1.0, np.where(np.arange(48) % 2, -1.0, 1.0)):
        for reflectance in (0.9, np.where(np.arange(48) < 24, 0.1, 0.9)):
            recording = Recording.of(Ping.of(distance, sides * angle, reflectance=reflectance), Reading.of(distance))
            for name, (draw, _) in FIGURES.items():
                pixel = np.asarray(Image.open(io.BytesIO(draw(recording))).convert("L"))
                edge = np.concatenate([pixel[0], pixel[-1], pixel[:, 0], pixel[:, -1]])
                assert edge.min() > 200, name
