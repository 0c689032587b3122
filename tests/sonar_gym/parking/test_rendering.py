"""Pictures: their form, what they show, and that no display is needed."""

import gymnasium
import numpy as np
import pytest

from acquisition import Reading
from noise import GaussianModel, IdealModel
from sonar_gym.parking import drawing, rendering
from sonar_gym.parking.drawing import Camera, credence_colour

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def picture(seed=0, steps=0, **settings):
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


def test_picture_has_the_form_that_gymnasium_asks_for():
    frame = picture()
    assert frame.dtype == np.uint8
    assert frame.shape == (660, 1000, 3)


def test_same_seed_same_picture():
    assert np.array_equal(picture(4, 10, sonar="gaussian"), picture(4, 10, sonar="gaussian"))


def test_car_and_paper_are_in_the_picture():
    frame = picture()
    assert share(frame, drawing.CAR) > 0.003
    assert share(frame, drawing.PAPER) > 0.1


def test_bad_readings_are_red_and_good_ones_green():
    good, bad = credence_colour(1.0), credence_colour(0.0)
    trusted = picture(sonar="ideal")
    assert share(trusted, good) > 0.002
    doubtful = picture(sonar=GaussianModel(sigma=2.0))
    assert share(doubtful, good) < share(trusted, good) / 3
    assert bad == drawing.CREDENCE[0]


def test_camera_turns_metres_into_pixels_with_up_up():
    camera = Camera(left=1.0, top=2.0, scale=100.0, x=10.0, y=20.0)
    assert camera.place((1.5, 1.0)) == (60.0, 120.0)


def test_human_mode_shows_a_window_and_returns_nothing(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gymnasium.make("SonarParking-v0", render_mode="human")
    env.reset(seed=0)
    env.step(np.zeros(2, dtype=np.float32))
    assert env.unwrapped.render() is None
    env.close()


class Haunted(IdealModel):
    """Reads half a metre whatever is there."""

    def law(self, ping, past=None):
        law = super().law(ping, past)
        law.sample = lambda rng: Reading.of(np.full(len(ping), 0.5))
        return law


def test_ghosts_are_struck_out_and_named(monkeypatch):
    nose = {"name": "nose", "x": 0.36, "y": 0.0, "heading_deg": 0.0, "cone_deg": 10.0}
    side = {"name": "side", "x": 0.0, "y": -0.1, "heading_deg": -90.0}
    env = gymnasium.make("SonarParking-v0", render_mode="rgb_array", sonar=Haunted(), sonar_layout=[nose, side])
    env.reset(options={"boxes": [{"begin": 3.0, "length": 0.3}, {"begin": 4.2, "length": 0.3}]})
    assert env.unwrapped.world.causes == ("ghost", "target")  # the street's end is beyond the nose's reach
    crosses, draw = [], rendering._cross
    monkeypatch.setattr(rendering, "_cross", lambda *given: crosses.append(given) or draw(*given))
    env.render()
    assert len(crosses) == 2  # the nose's, and that of the legend
