"""Sonars of Webots and Gazebo: lookup tables as models, and the nearest sonar that they can hold."""

from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import ModelError, Ping, RecordingError, RecordingNotFoundError, SettingError
from noise import GaussianModel, load_model, save_model
from noise.metrics import crps
from noise.model import IdealModel
from noise.table import TableModel
from sonar_gym.bridges.simulators import gazebo, webots
from sonar_gym.bridges.simulators.nearest import fit_normal, nearest_gaussian, nearest_table, normal_crps

LIMIT = webots.SONAR_INCIDENCE
WORLD = """#VRML_SIM R2023b utf8
Robot {
  children [
    DistanceSensor {  # { a brace in a comment
      name "front"
      type "sonar"
      lookupTable [ 0 0 0.1
        2 2 0.1, 5 5 0.02 ]
    }
    DEF REAR DistanceSensor { children [ Shape { } ] name "rear" lookupTable [ 0 1000 0, 0.1 500 0.1, 0.2 100 0.1 ] }
    DistanceSensor { }
  ]
}
"""


@pytest.fixture
def world(tmp_path):
    path = tmp_path / "world.wbt"
    path.write_text(WORLD)
    return path


def test_lookup_tables_are_read_with_their_names(world):
    models = webots.load_tables(world)
    assert list(models) == ["front", "rear"]
    front, rear = models["front"], models["rear"]
    assert (front.distances, front.means, front.max_range) == ((0.0, 2.0, 5.0), (0.0, 2.0, 5.0), 5.0)
    np.testing.assert_allclose(front.sigmas, (0.0, 0.2, 0.1))
    assert rear.means == rear.distances  # inverted: 500 of the second row is 0.1 m
    np.testing.assert_allclose(rear.sigmas[2], 10.0 / 4000.0)  # 10 units, where the table falls by 4000 units a metre


def test_a_sonar_of_webots_is_deaf_to_slanted_faces_and_another_type_is_not(world):
    models = webots.load_tables(world)
    slanted = Ping.of(0.15, 0.0, [np.radians(22.0), np.radians(23.0)])
    np.testing.assert_array_equal(models["front"].law(slanted).echo, [1.0, 0.0])
    np.testing.assert_array_equal(models["rear"].law(slanted).echo, [1.0, 1.0])


def test_values_in_a_unit_keep_their_bias(tmp_path):
    path = tmp_path / "sensor.proto"
    path.write_text("DistanceSensor { lookupTable [0 150 0, 1 1100 0.05, 2 2050 0.05] }")
    (model,) = webots.load_tables(path, metres_per_unit=0.001).values()
    np.testing.assert_allclose(model.means, (0.15, 1.1, 2.05))
    np.testing.assert_allclose(model.sigmas, (0.0, 0.055, 0.1025))


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("Robot { }", RecordingError, "has no DistanceSensor with a lookupTable"),
        ("DistanceSensor { lookupTable [0 1 0, 1 2] }", RecordingError, "has 5 numbers, expected 2 or more rows of 3"),
        ("DistanceSensor { lookupTable [0 1 x, 1 2 0] }", RecordingError, "could not convert"),
        ("DistanceSensor { lookupTable [1 1 0, 0 2 0] }", RecordingError, "must be >= 0 m and increase"),
        ("DistanceSensor { lookupTable [0 9 0, 1 9 0, 2 0 0] }", SettingError, "give --metres-per-unit"),
    ],
)
def test_a_table_that_cannot_be_used_is_named(tmp_path, text, kind, message):
    path = tmp_path / "world.wbt"
    path.write_text(text)
    with pytest.raises(kind, match=message):
        webots.load_tables(path)


def test_a_missing_world_is_named(tmp_path):
    with pytest.raises(RecordingNotFoundError, match=r"give a \.wbt or \.proto file"):
        webots.load_tables(tmp_path / "world.wbt")


def test_a_table_is_saved_and_loaded(tmp_path):
    model = TableModel((0.0, 2.0), (0.1, 2.1), (0.01, 0.02), 3.0, 0.4)
    assert load_model(save_model(model, tmp_path / "model")) == model
    with pytest.raises(ModelError, match="cannot be built"):
        TableModel.from_dict({"kind": "table", "distances": [0.0]})


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"means": (1.0,)}, "columns of one length"),
        ({"distances": (2.0, 1.0)}, "must be >= 0 m and increase"),
        ({"sigmas": (0.0, -0.1)}, "sigmas must be >= 0 m"),
        ({"max_range": 0.0}, "max_range must be > 0"),
        ({"means": (0.0, np.nan)}, "not finite"),
    ],
)
def test_a_table_outside_its_limits_is_named(change, text):
    columns = {"distances": (0.0, 1.0), "means": (0.0, 1.0), "sigmas": (0.0, 0.1), "max_range": 2.0, **change}
    with pytest.raises(SettingError, match=text):
        TableModel(**columns)


@given(st.floats(0.5, 3.0), st.floats(0.01, 0.2))
def test_the_crps_of_a_normal_law_is_that_of_its_quantiles(mean, sigma):
    law = TableModel((0.0,), (mean,), (sigma,), 10.0).law(Ping.of(np.full(30, mean)))
    reading = law.sample(np.random.default_rng(0))
    np.testing.assert_allclose(normal_crps(mean, sigma, reading.range), crps(law, reading, 4000), atol=2e-3)


def test_the_fit_finds_the_normal_law_that_was_drawn_from():
    value = np.random.default_rng(0).normal(1.5, 0.1, 20_000)
    mean, sigma = fit_normal(value)
    assert (mean, sigma) == (pytest.approx(1.5, abs=0.003), pytest.approx(0.1, abs=0.003))


def test_readings_without_noise_have_a_normal_law_too():
    mean, sigma = fit_normal(np.full(50, 1.5))
    assert mean == pytest.approx(1.5, abs=1e-3)
    assert 0.0 < sigma < 1e-3


def test_what_a_simulator_can_hold_it_holds_without_an_error():
    model = GaussianModel(0.02, 0.0)
    assert nearest_gaussian(model, 3.0).left_mm == pytest.approx(0.0, abs=0.5)
    table = nearest_table(TableModel((0.0, 3.0), (0.1, 3.0), (0.01, 0.05), 4.0, LIMIT), 3.0, LIMIT)
    assert table.left_mm == pytest.approx(0.0, abs=1.0)


def test_a_learned_sonar_leaves_an_error_and_less_in_a_table():
    model = load_model("srf08-mlp")
    table, deaf = (nearest_table(model, 3.0, limit) for limit in (np.pi / 2, LIMIT))
    gaussian = nearest_gaussian(model, 3.0)
    assert 0.0 < table.left_mm < gaussian.left_mm
    assert table.left_mm < deaf.left_mm  # the limit of incidence costs something
    assert table.model_crps_mm == gaussian.model_crps_mm > 0.0
    assert 0.1 < table.silent < 0.9


def test_the_node_for_webots_is_read_back_as_its_table(tmp_path):
    text, nearest = webots.export(load_model("srf08-mlp"), 3.0, 55.0)
    path = tmp_path / "sonar.wbt"
    path.write_text(text)
    (model,) = webots.load_tables(path, metres_per_unit=1.0).values()
    ping = Ping.of(np.linspace(0.1, 2.9, 9))
    for name in ("mean", "sigma"):
        np.testing.assert_allclose(getattr(model.law(ping), name), getattr(nearest.table.law(ping), name), rtol=2e-3)
    assert model.max_incidence == webots.SONAR_INCIDENCE


def test_the_sensor_for_gazebo_holds_the_fitted_noise():
    text, nearest = gazebo.export(GaussianModel(0.02, 0.0), 3.0, 60.0)
    sensor = ElementTree.fromstring(text)
    assert float(sensor.findtext("lidar/noise/stddev")) == pytest.approx(nearest.table.sigmas[0], rel=1e-4)
    assert float(sensor.findtext("lidar/range/max")) == 3.0
    assert float(sensor.findtext("lidar/scan/horizontal/max_angle")) == pytest.approx(np.radians(30.0), rel=1e-5)


def test_a_model_without_probabilities_and_a_range_outside_limits_are_named():
    with pytest.raises(SettingError, match="can only be sampled"):
        nearest_gaussian(load_model("rig"), 3.0)
    with pytest.raises(SettingError, match=r"max_range must lie in \[0.1, 20\] m, got 50 m"):
        nearest_gaussian(IdealModel(), 50.0)
