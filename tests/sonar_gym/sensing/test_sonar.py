"""Credence on the street is calibrated; sets of sonars share a model."""

import gymnasium
import numpy as np
import pytest

from acquisition import Ping, Reading
from noise import CredenceTable, GaussianModel, IdealModel, save_model
from sonar_gym.control.driver import ParkingDriver, run_episode
from sonar_gym.parking.environment import MAX_RANGE
from sonar_gym.parking.prior import street_credence, street_pings
from sonar_gym.parking.street import StreetSettings
from sonar_gym.parking.vehicle import CarSettings
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.sensing.scene import EMPTY_M
from sonar_gym.sensing.sonar import BINS, Sonar, bin_edges, broad_table, resolve

STREET = (StreetSettings(), CarSettings(), LAYOUTS["eight"], MAX_RANGE)


@pytest.mark.parametrize("sonar", ["gaussian", "srf08-mlp"])
def test_share_of_right_readings_equals_the_mean_credence(sonar):
    env, driver, credence, right = gymnasium.make("SonarParking-v0", sonar=sonar), ParkingDriver(), [], []
    for seed in range(3000, 3008):
        episode = run_episode(env, driver, seed)
        echo = episode.echoes == 1
        credence.extend(episode.credence[echo])
        right.extend((np.abs(episode.readings - episode.truths) <= 0.1 * episode.truths)[echo])
    credence, right = np.array(credence), np.array(right)
    assert np.mean(right) == pytest.approx(np.mean(credence), abs=0.05)
    place = np.digitize(credence, [0.2, 0.4, 0.6, 0.8])
    for k in range(5):
        if np.sum(place == k) > 300:
            assert np.mean(right[place == k]) == pytest.approx(np.mean(credence[place == k]), abs=0.15)


def test_front_sonars_detect_faces_at_the_edge_of_the_cone_and_side_sonars_do_not():
    pings = dict(zip([mount.name for mount in LAYOUTS["eight"]], street_pings(*STREET), strict=True))
    for ping in pings.values():
        assert len(ping) > 500
        assert np.all(np.abs(ping.angle) <= np.radians(27.5) + 1e-9)
        assert np.all((ping.distance <= MAX_RANGE) | (ping.distance == EMPTY_M))
    edge = {name: np.mean(np.abs(ping.angle) > np.radians(27.0)) for name, ping in pings.items()}
    assert edge["left"] < 0.5 < edge["front"]


def test_credence_of_a_sonar_without_noise_is_one():
    for table in street_credence(IdealModel(), *STREET):
        assert np.all(table.values[: int(BINS / 1.1)] == 1.0)


def test_mixture_of_tables_is_the_table_of_the_mixture():
    model, edges = GaussianModel(sigma=0.05), bin_edges(3.0)
    near, far = Ping.of(np.linspace(0.1, 1.0, 50)), Ping.of(np.linspace(0.5, 3.0, 50))
    both = Ping.of(np.r_[near.distance, far.distance])
    mixed = CredenceTable.over(model, near, edges).mixed(CredenceTable.over(model, far, edges), 0.5)
    whole = CredenceTable.over(model, both, edges)
    assert mixed.values == pytest.approx(whole.values, abs=1e-9)
    assert mixed.share == pytest.approx(whole.share)


def test_each_sonar_has_its_own_table():
    model = GaussianModel()
    table = broad_table(model, 3.0)
    halved = CredenceTable(table.edges, 0.5 * table.values, table.share)
    sonar = Sonar(model, 3, 3.0, tables=[table, halved, table])
    credence = sonar.credence(Reading.of([1.0, 1.0, 0.0]))
    assert credence == pytest.approx([table.given(Reading.of([1.0]))[0], 0.5 * credence[0], 0.0])


def test_readings_beyond_the_maximum_range_are_no_echo():
    sonar = Sonar(IdealModel(), 2, 1.0)
    place = np.arange(2)
    reading = sonar.draw(Ping.of([0.5, 2.0]), [0], [2], place, place, place).reading
    assert list(reading.echo) == [True, False]
    assert list(reading.range) == [0.5, 0.0]


def test_a_named_model_is_loaded_once_and_one_in_a_folder_each_time(tmp_path):
    assert resolve("srf08-mlp") is resolve("srf08-mlp")
    folder = tmp_path / "mine"
    save_model(GaussianModel(sigma=0.01), folder)
    first = resolve(folder)
    save_model(GaussianModel(sigma=0.02), folder)
    assert (first, resolve(folder)) == (GaussianModel(sigma=0.01), GaussianModel(sigma=0.02))
