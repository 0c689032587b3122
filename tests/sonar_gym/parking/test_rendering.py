"""Rendering: format and content of images; no display is needed."""

import itertools

import gymnasium
import numpy as np
import pytest

from acquisition import Reading
from noise import GaussianModel, IdealModel
from sonar_gym.parking import drawing
from sonar_gym.parking.drawing import Brush, Camera, credence_colour
from sonar_gym.parking.rendering import FOOTER, HEIGHT
from sonar_gym.parking.world import WorldView
from sonar_gym.sensing.records import CAUSES

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def image(seed=0, steps=0, **settings):
    env = gymnasium.make("SonarParking-v0", render_mode="rgb_array", **settings)
    env.reset(seed=seed)
    for _ in range(steps):
        env.step(np.array([0.0, 1.0], dtype=np.float32))
    frame = env.render()
    env.close()
    env.close()
    return frame


def share(frame, colour):
    return np.mean(np.all(frame == np.array(colour, dtype=np.uint8), axis=2))


def test_image_has_the_format_of_gymnasium():
    frame = image()
    assert frame.dtype == np.uint8
    assert frame.shape == (660, 1000, 3)


def test_same_seed_gives_same_image():
    assert np.array_equal(image(4, 10, sonar="gaussian"), image(4, 10, sonar="gaussian"))


def test_car_and_background_are_in_the_image():
    frame = image()
    assert share(frame, drawing.CAR) > 0.003
    assert share(frame, drawing.PAPER) > 0.1


def test_the_car_in_the_overview_is_as_long_as_it_is(monkeypatch):
    widths, draw = [], Brush.panel

    def measured(self, x, y, width, height, colour, *more):
        if colour == drawing.CAR and height == 8:
            widths.append(width)
        draw(self, x, y, width, height, colour, *more)

    monkeypatch.setattr(Brush, "panel", measured)
    for length in (0.45, 0.60):
        image(car={"length": length})
    assert len(widths) == 2
    assert widths[1] / widths[0] == pytest.approx(0.60 / 0.45)


def test_readings_of_low_credence_are_red_and_others_green():
    high, low = credence_colour(1.0), credence_colour(0.0)
    ideal = image(sonar="ideal")
    assert share(ideal, high) > 0.002
    noisy = image(sonar=GaussianModel(sigma=2.0), credence_driver=None)
    assert share(noisy, high) < share(ideal, high) / 3
    assert low == drawing.CREDENCE[0]


def test_camera_transforms_metres_to_pixels_with_y_up():
    camera = Camera(left=1.0, top=2.0, scale=100.0, x=10.0, y=20.0)
    assert camera.pixel((1.5, 1.0)) == (60.0, 120.0)


def test_human_mode_shows_a_window_and_returns_nothing(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gymnasium.make("SonarParking-v0", render_mode="human")
    env.reset(seed=0)
    env.step(np.zeros(2, dtype=np.float32))
    assert env.unwrapped.render() is None
    env.close()


class FixedEcho(IdealModel):
    """A sonar that always reads 0.5 m."""

    def law(self, ping, past=None):
        law = super().law(ping, past)
        law.sample = lambda rng: Reading.of(np.full(len(ping), 0.5))
        return law


def test_ghosts_are_marked_and_labelled(monkeypatch):
    nose = {"name": "nose", "x": 0.36, "y": 0.0, "heading_deg": 0.0, "cone_deg": 10.0}
    side = {"name": "side", "x": 0.0, "y": -0.1, "heading_deg": -90.0}
    env = gymnasium.make("SonarParking-v0", render_mode="rgb_array", sonar=FixedEcho(), sonar_layout=[nose, side])
    env.reset(options={"boxes": [{"begin": 3.0, "length": 0.3}, {"begin": 4.2, "length": 0.3}]})
    assert env.unwrapped.world.causes == ("ghost", "target")  # the end of the street is out of range of the nose
    lines, texts, draw_line, draw_text = [], [], Brush.line, Brush.text
    monkeypatch.setattr(
        Brush, "line", lambda self, points, *a, **k: lines.append(points) or draw_line(self, points, *a, **k)
    )
    monkeypatch.setattr(Brush, "text", lambda self, text, *a, **k: texts.append(text) or draw_text(self, text, *a, **k))
    env.render()
    diagonals = [p for p in lines if len(p) == 2 and np.allclose(np.abs(np.subtract(*p)), 10.0)]
    assert len(diagonals) == 2 * 4  # two lines and their outlines, at the ghost and in the legend
    assert texts.count("ghost") == 1


@pytest.mark.parametrize("cause", [*CAUSES, "SHORT", "CONSTANT", "NOISE"])
def test_words_do_not_overlap(monkeypatch, cause):
    boxes, draw_text = [], Brush.text

    def measured(self, text, pixel, size, colour=drawing.INK, at="w"):
        width, height = (length / self.detail for length in self._font(size).size(text))
        left = pixel[0] - {"w": 0.0, "e": width, "c": width / 2}[at]
        boxes.append((text, left, left + width, pixel[1] - height / 2, pixel[1] + height / 2))
        draw_text(self, text, pixel, size, colour, at)

    monkeypatch.setattr(Brush, "text", measured)
    monkeypatch.setattr(WorldView, "causes", property(lambda self: (cause,) * len(self.mounts)))
    width = image().shape[1]
    panel = [box for box in boxes if box[3] > HEIGHT - FOOTER]
    assert len(panel) > 2 * 8
    assert all(left >= 0 and right <= width for _, left, right, *_ in panel)
    pairs = [(a, b) for a, b in itertools.combinations(panel, 2) if a[1] < b[2] and b[1] < a[2]]
    assert [(a[0], b[0]) for a, b in pairs if a[3] + 4 < b[4] and b[3] + 4 < a[4]] == []  # 4: above and below letters
