"""The published networks: reference predictions, small networks by hand, and rejection of other files."""

import json
import math
from dataclasses import dataclass

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition import ModelError
from noise.learned.thesis import load_thesis_network

BEST = {"mlp": "mlp_nadam_25_15_1_weights.hdf5", "lstm": "lstm_nadam_25_15_1_weights.hdf5"}
LAST = {"mlp": "mlp_nadam_25_15_1_my_model.h5", "lstm": "lstm_nadam_25_15_1_my_model.h5"}


@pytest.mark.parametrize("kind", BEST)
def test_published_networks_give_the_reference_predictions(thesis_files, kind):
    """Those that did best in validation (`*_weights.hdf5`); the `*_my_model.h5` hold the last epoch's weights."""
    network = load_thesis_network(thesis_files / BEST[kind])
    table = pd.read_csv(thesis_files / "reference-predictions.csv")
    inputs = table[["angle", "reflectance", "reading", "credence"]].to_numpy()
    assert network.kind == kind
    assert np.abs(network.output(inputs) - table[kind]).max() < 1e-5


@pytest.mark.parametrize("kind", BEST)
@pytest.mark.parametrize("files", [BEST, LAST], ids=["best", "last"])
def test_distances_are_in_metres_by_the_thesis_s_scales(thesis_files, files, kind):
    """Table 4.1: at 30 degrees the mirror at 3900 mm was read as 3950 to 3970 mm, with a credence of 0.88."""
    network = load_thesis_network(thesis_files / files[kind])
    distance = network.distance(np.deg2rad(30.0), 0.9, [3.95, 3.96, 3.97], 0.88)
    assert distance == pytest.approx(3.9, abs=0.1)
    rows = np.array([[30.0 / 45.0, 0.9, 3.96 / 6.0, 0.88]])
    assert distance[1] == pytest.approx(0.030 + 5.970 * network.output(rows)[0])


@dataclass
class Layer:
    name: str
    cls: str
    config: dict
    weights: dict


def write(path, layers, version="1.0.8"):
    config = [{"class_name": layer.cls, "config": {**layer.config, "name": layer.name}} for layer in layers]
    with h5py.File(path, "w") as file:
        file.attrs["keras_version"] = version
        file.attrs["model_config"] = json.dumps({"class_name": "Sequential", "config": config}).encode()
        for layer in layers:
            group = file.create_group(f"model_weights/{layer.name}")
            for name, value in layer.weights.items():
                group[name] = np.asarray(value, dtype=np.float32)
    return path


DROPOUT = Layer("dropout_1", "Dropout", {"p": 0.05}, {})


def mlp(**changed):
    first = {"dense_1_W": [[1.0, -1.0], [2.0, 0.5], [0.0, 3.0], [-1.0, 0.25]], "dense_1_b": [0.5, -0.5]}
    second = {"dense_2_W": [[1.5], [-2.0]], "dense_2_b": [0.25]}
    settings = {"activation": "sigmoid", "output_dim": 2}
    return [
        Layer("dense_1", "Dense", {**settings, **changed}, first),
        DROPOUT,
        Layer("dense_2", "Dense", {"activation": "sigmoid", "output_dim": 1}, second),
    ]


def lstm(units=1, **changed):
    gates = {"i": (0.5, 0.25, 0.1), "f": (0.3, -0.2, 1.0), "c": (1.0, 0.5, -0.4), "o": (-0.6, 0.8, 0.2)}
    weights = {}
    for gate, (w, u, b) in gates.items():
        weights |= {f"lstm_1_W_{gate}": np.full((1, units), w), f"lstm_1_b_{gate}": np.full(units, b)}
        weights[f"lstm_1_U_{gate}"] = u * np.eye(units)
    settings = {"activation": "sigmoid", "inner_activation": "hard_sigmoid", "return_sequences": False}
    return [
        Layer("lstm_1", "LSTM", {**settings, "output_dim": units, **changed}, weights),
        DROPOUT,
        Layer(
            "dense_1",
            "Dense",
            {"activation": "linear", "output_dim": 1},
            {"dense_1_W": np.full((units, 1), 2.0), "dense_1_b": [-0.5]},
        ),
    ]


def sigmoid(x):
    return 1.0 / (1.0 + math.exp(-x))


def test_small_mlp_by_hand(tmp_path):
    network = load_thesis_network(write(tmp_path / "mlp.h5", mlp()))
    angle, reflectance, reading, credence = 30.0 / 45.0, 0.9, 1.5 / 6.0, 0.4
    hidden = (
        sigmoid(angle + 2.0 * reflectance - credence + 0.5),
        sigmoid(-angle + 0.5 * reflectance + 3.0 * reading + 0.25 * credence - 0.5),
    )
    expected = 0.030 + 5.970 * sigmoid(1.5 * hidden[0] - 2.0 * hidden[1] + 0.25)
    assert float(network.distance(np.deg2rad(30.0), 0.9, 1.5, 0.4)) == pytest.approx(expected, abs=1e-7)


def test_small_lstm_by_hand(tmp_path):
    """Four steps of one cell, with the gates' hard sigmoid in its linear part."""
    network = load_thesis_network(write(tmp_path / "lstm.h5", lstm()))
    cell = hidden = 0.0
    for x in (30.0 / 45.0, 0.9, 0.25, 0.4):
        input_gate = 0.2 * (0.5 * x + 0.25 * hidden + 0.1) + 0.5
        forget_gate = 0.2 * (0.3 * x - 0.2 * hidden + 1.0) + 0.5
        out = 0.2 * (-0.6 * x + 0.8 * hidden + 0.2) + 0.5
        cell = forget_gate * cell + input_gate * sigmoid(x + 0.5 * hidden - 0.4)
        hidden = out * sigmoid(cell)
    assert network.output(np.array([[30.0 / 45.0, 0.9, 0.25, 0.4]]))[0] == pytest.approx(2.0 * hidden - 0.5, abs=1e-7)


def test_independent_units_add_up(tmp_path):
    one = load_thesis_network(write(tmp_path / "one.h5", lstm()))
    three = load_thesis_network(write(tmp_path / "three.h5", lstm(3)))
    inputs = np.random.default_rng(0).random((50, 4))
    assert three.output(inputs) + 0.5 == pytest.approx(3.0 * (one.output(inputs) + 0.5), abs=1e-6)


def test_any_shape_of_arguments(tmp_path):
    network = load_thesis_network(write(tmp_path / "mlp.h5", mlp()))
    surface = network.distance(np.zeros((3, 1)), 0.9, np.linspace(0.0, 6.0, 5), 0.5)
    assert surface.shape == (3, 5)
    assert surface[1, 2] == network.distance(0.0, 0.9, 3.0, 0.5)


def changed_weight(path, name, value):
    with h5py.File(write(path, mlp()), "a") as file:
        del file[name]
        if value is not None:
            file[name] = value
    return path


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda p: p, "no such file; give one of the networks"),
        (lambda p: p.write_bytes(b"not a network") and p, "not a complete HDF5 file"),
        (lambda p: p.write_bytes(bytes(2 << 20)) and p, "2097152 bytes, but the thesis's networks are under 1048576"),
        (lambda p: write(p, mlp(), version="2.1.0"), "of Keras 2.1.0, expected 1.0.8"),
        (lambda p: write(p, mlp(activation="relu")), r"layers are Dense \(relu\), Dropout \(-\), Dense \(sigmoid\)"),
        (
            lambda p: write(p, lstm(inner_activation="sigmoid")),
            r"layers are LSTM \(sigmoid\), .*: neither the thesis's",
        ),
        (lambda p: write(p, mlp()[:1]), "neither the thesis's MLP nor its LSTM"),
        (lambda p: write(p, []), "layers are none: neither"),
        (lambda p: write(p, mlp(output_dim=3)), r"dense_1_W is float32 of shape \(4, 2\), expected .* shape \(4, 3\)"),
        (
            lambda p: changed_weight(p, "model_weights/dense_1/dense_1_b", None),
            "contains no array model_weights/dense_1",
        ),
        (
            lambda p: changed_weight(p, "model_weights/dense_1/dense_1_b", h5py.ExternalLink("other.h5", "/x")),
            "contains no array model_weights/dense_1/dense_1_b",
        ),
        (lambda p: changed_weight(p, "model_weights/dense_1/dense_1_b", np.array([0.0, np.nan])), "not finite"),
        (lambda p: changed_weight(p, "model_weights/dense_1/dense_1_b", np.array([1, 2])), "is int64 of shape"),
    ],
)
def test_other_files_raise(tmp_path, make, message):
    with pytest.raises(ModelError, match=message):
        load_thesis_network(make(tmp_path / "file.h5"))


@pytest.mark.parametrize("config", [b"{broken", b"[" * 50_000])
def test_a_file_without_a_readable_model_raises(tmp_path, config):
    path = write(tmp_path / "file.h5", mlp())
    with h5py.File(path, "a") as file:
        file.attrs["model_config"] = config
    with pytest.raises(ModelError, match="its `model_config` is not that of a Keras 1 model"):
        load_thesis_network(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return write(tmp_path_factory.mktemp("whole") / "mlp.h5", mlp())


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 0.999))
def test_truncated_files_raise(tmp_path, whole, share):
    data = whole.read_bytes()
    path = tmp_path / "cut.h5"
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ModelError, match=r"cut\.h5"):
        load_thesis_network(path)
