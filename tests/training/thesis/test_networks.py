"""The thesis's networks with the published weights, and distributions of initial weights."""

from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

from training.thesis.networks import FlatNetwork


@pytest.fixture(scope="module")
def thesis(real_recordings) -> Path:
    folder = real_recordings.parent / "thesis"
    if not folder.is_dir():
        pytest.skip(f"no published networks at {folder}")
    return folder


def published(path, kind):
    """Return the published weights as a flat vector."""
    with h5py.File(path) as file:
        weights: dict[str, np.ndarray] = {}
        file.visititems(
            lambda name, node: weights.__setitem__(name.split("/")[-1], node[...]) if hasattr(node, "shape") else None
        )
    if kind == "mlp":
        order = [weights[name] for name in ("dense_1_W", "dense_1_b", "dense_2_W", "dense_2_b")]
    else:
        step, recurrent, bias = ([weights[f"lstm_1_{array}_{gate}"] for gate in "ifoc"] for array in ("W", "U", "b"))
        order = [
            np.array(step),
            np.stack(recurrent, axis=1),
            np.array(bias),
            weights["dense_1_W"],
            weights["dense_1_b"],
        ]
    return np.concatenate([array.ravel() for array in order]).astype(np.float32)


@pytest.mark.parametrize("kind", ["mlp", "lstm"])
def test_published_weights_give_the_published_predictions(thesis, kind):
    reference = pd.read_csv(thesis / "reference-predictions.csv")
    feature = reference[["angle", "reflectance", "reading", "credence"]].to_numpy(np.float32)
    theta = published(thesis / f"{kind}_nadam_25_15_1_weights.hdf5", kind)
    np.testing.assert_allclose(FlatNetwork(kind, 25).predict(theta, feature), reference[kind], atol=1e-5)


def test_initial_weights_have_their_distributions():
    rng = np.random.default_rng(0)
    lstm = FlatNetwork("lstm", 25)
    theta = lstm.initial(rng)
    parts = np.split(theta, np.cumsum([np.prod(shape) for shape in lstm.shapes.values()])[:-1])
    step, recurrent, bias, output, last = (p.reshape(s) for p, s in zip(parts, lstm.shapes.values(), strict=True))
    assert 2.2 < np.abs(step).max() <= np.sqrt(6.0)
    for gate in range(4):
        np.testing.assert_allclose(recurrent[:, gate] @ recurrent[:, gate].T, np.eye(25), atol=1e-5)
    assert bias[1].tolist() == [1.0] * 25
    assert not bias[[0, 2, 3]].any()
    assert not last.any()
    assert 0.4 < np.abs(output).max() <= np.sqrt(6.0 / 26)
    he = FlatNetwork("mlp", 1000).initial(rng)[:4000]
    assert np.abs(he).max() <= np.sqrt(6.0 / 4)
    assert he.std() == pytest.approx(np.sqrt(2.0 / 4), rel=0.05)  # He et al. (2015), eq. 10


@pytest.mark.parametrize("network", [FlatNetwork("mlp", 20), FlatNetwork("lstm", 3), FlatNetwork("lstm", 1)], ids=str)
def test_biases_are_not_penalised_and_shapes_are_consistent(network):
    theta = network.initial(np.random.default_rng(1))
    assert theta.shape == network.penalised.shape == (network.size,)
    biases = sum(np.prod(s) for name, s in network.shapes.items() if name.endswith("bias"))
    assert network.size - network.penalised.sum() == biases
