"""Credence given the last readings: its features and its file format."""

import json
from itertools import pairwise

import numpy as np
import pytest

from acquisition import ModelError, Ping, Reading
from noise.learned.recent import ABOUT_FILE, N_FEATURES, RecentCredence, RecentReadings


def random_credence(depth=3, seed=0):
    rng = np.random.default_rng(seed)
    sizes = [depth * N_FEATURES, 5, 1]
    layers = [(rng.normal(size=(b, a)), rng.normal(size=b)) for a, b in pairwise(sizes)]
    return RecentCredence(depth, layers, {})


def course():
    rng = np.random.default_rng(0)
    ping = Ping.of(rng.uniform(0.2, 3.0, 40), run=rng.integers(0, 3, 40), time=np.sort(rng.uniform(0, 9, 40)))
    status = rng.choice(3, 40, p=[0.2, 0.7, 0.1])
    return ping, Reading.of(np.where(status == 1, ping.distance, 0.0), status)


def test_of_recording_agrees_with_updates_in_every_run():
    ping, reading = course()
    whole = random_credence().follow(ping, reading)
    for run in range(3):
        recent = RecentReadings.empty(3, 1)
        for k in np.flatnonzero(ping.run == run):
            recent = recent.updated(reading[[k]], ping.time[[k]])
            assert random_credence().given(recent)[0] == pytest.approx(whole[k], abs=1e-12)


def test_only_echoes_have_credence_and_only_the_last_readings_count():
    ping, reading = course()
    credence = random_credence().follow(ping, reading)
    assert np.all(credence[~reading.echo] == 0.0)
    assert np.all((credence[reading.echo] > 0) & (credence[reading.echo] < 1))
    rows = np.flatnonzero(ping.run == 0)[-3:]
    assert random_credence().follow(ping[rows], reading[rows])[-1] == pytest.approx(credence[rows[-1]], abs=1e-12)


def test_cleared_sensors_have_no_earlier_readings():
    ping, reading = course()
    recent = RecentReadings.empty(3, 2)
    for k in range(0, 8, 2):
        recent = recent.updated(reading[[k, k + 1]], ping.time[[k, k + 1]])
    recent = recent.cleared(np.array([True, False]))
    assert not recent.known[:, 0].any()
    assert recent.known[:, 1].all()


def test_a_saved_network_gives_the_same_credence(tmp_path):
    ping, reading = course()
    one = random_credence()
    again = RecentCredence.load(one.save(tmp_path / "credence"))
    np.testing.assert_allclose(again.follow(ping, reading), one.follow(ping, reading), atol=1e-5)


@pytest.mark.parametrize("broken", [{"sizes": [7, 1]}, {"depth": 0}, {"format": 9}, {"depth": "many"}])
def test_an_invalid_description_raises_with_its_path(tmp_path, broken):
    folder = random_credence().save(tmp_path / "credence")
    path = folder / ABOUT_FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), **broken}))
    with pytest.raises(ModelError, match=r"credence\.json"):
        RecentCredence.load(folder)
    with pytest.raises(ModelError, match=r"contains no credence\.json"):
        RecentCredence.load(tmp_path)
