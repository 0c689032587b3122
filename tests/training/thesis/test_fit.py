"""Training of the thesis's networks on data with a known noise level."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from acquisition import SettingError
from training.thesis.data import Samples
from training.thesis.fit import Recipe, device_of, fit, mean_squared_error
from training.thesis.networks import FlatNetwork


def samples(n=3000, seed=0, scatter=0.05):
    """Return pings whose label is a smooth function of the inputs, with noise of a known variance."""
    rng = np.random.default_rng(seed)
    feature = rng.random((n, 4), dtype=np.float32)
    label = 0.3 + 0.3 * feature[:, 2] + 0.1 * np.sin(3 * feature[:, 0]) + rng.normal(0, scatter, n)
    return Samples(feature, label.astype(np.float32), np.arange(n))


TRAIN, VALIDATION = samples(seed=0), samples(seed=1)
ONLINE = Recipe(epochs=12, dropout=0.0)
BATCHED = Recipe(epochs=40, batch=64, dropout=0.0, learning_rate=0.02, falls_to=0.01)


def trained(recipe, network=None, seed=3):
    return fit(network or FlatNetwork("mlp", 8), TRAIN, VALIDATION, recipe, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("recipe", "kind"),
    [(ONLINE, "mlp"), (BATCHED, "mlp"), (ONLINE, "lstm"), (replace(BATCHED, epochs=25), "lstm")],
    ids=["online-mlp", "batched-mlp", "online-lstm", "batched-lstm"],
)
def test_the_loss_converges_to_the_noise_variance(recipe, kind):
    fitted = trained(recipe, FlatNetwork(kind, 8))
    assert 0.9 * 0.05**2 < fitted.validation.min() < 1.3 * 0.05**2
    assert fitted.validation[0] > fitted.validation.min()


@pytest.mark.parametrize("recipe", [ONLINE, replace(BATCHED, learning_rate=0.5, epochs=15)], ids=["online", "batched"])
def test_the_best_weights_are_returned(recipe):
    fitted = trained(recipe)
    assert mean_squared_error(FlatNetwork("mlp", 8), fitted.theta, VALIDATION) == fitted.validation.min()
    assert fitted.validation[fitted.best_epoch - 1] == fitted.validation.min()


def test_training_stops_when_the_loss_does_not_decrease():
    fitted = trained(replace(ONLINE, epochs=400, patience=3, learning_rate=0.05))
    assert len(fitted.validation) == fitted.best_epoch + 3 < 400


@pytest.mark.parametrize("recipe", [ONLINE, BATCHED], ids=["online", "batched"])
def test_equal_seeds_give_equal_results(recipe):
    recipe = replace(recipe, epochs=3, dropout=0.1)
    one, same, other = trained(recipe), trained(recipe), trained(recipe, seed=4)
    np.testing.assert_array_equal(one.theta, same.theta)
    np.testing.assert_array_equal(one.validation, same.validation)
    assert not np.array_equal(one.theta, other.theta)


def test_compiled_online_training_agrees_with_batches_of_one():
    """Without dropout, compiled training and torch differ only by rounding."""
    network, first = FlatNetwork("mlp", 6), np.random.default_rng(0).permutation(300)
    part = TRAIN[first]
    recipe = Recipe(epochs=2, dropout=0.0, l2=1e-4)

    class OnCpu(Recipe):
        compiled = False

    torched = OnCpu(epochs=2, dropout=0.0, l2=1e-4)
    runs = [fit(network, part, VALIDATION, r, Ordered(9)) for r in (recipe, torched)]
    np.testing.assert_allclose(runs[0].validation, runs[1].validation, rtol=1e-4)
    np.testing.assert_allclose(runs[0].train, runs[1].train, rtol=1e-4)


class Ordered:
    """Random generator with a separate stream for the order of pings."""

    def __init__(self, seed):
        self._rng, self._order = np.random.default_rng(seed), np.random.default_rng(seed + 1)

    def permutation(self, n):
        return self._order.permutation(n)

    def __getattr__(self, name):
        return getattr(self._rng, name)


@pytest.mark.parametrize("recipe", [ONLINE, BATCHED], ids=["online", "batched"])
def test_penalties_shrink_weights(recipe):
    network, recipe = FlatNetwork("mlp", 8), replace(recipe, epochs=min(recipe.epochs, 15))
    free = trained(recipe).theta
    for penalty in ({"l1": 3e-3}, {"l2": 3e-3}, {"l1": 2e-3, "l2": 2e-3}):
        shrunk = trained(replace(recipe, **penalty)).theta
        weights = network.penalised
        assert np.abs(shrunk[weights]).sum() < 0.5 * np.abs(free[weights]).sum()
    lasso = trained(replace(recipe, l1=3e-3)).theta
    assert np.mean(np.abs(lasso[network.penalised]) < 0.02) > 0.5  # the lasso sets weights to about 0


def test_dropout_increases_the_training_loss():
    fitted = trained(Recipe(epochs=8, dropout=0.3))
    assert fitted.train[-1] > 1.2 * fitted.validation[-1]


def test_settings_out_of_range_and_missing_devices_are_errors():
    with pytest.raises(SettingError, match=r"dropout 1 must lie between 0 and 0\.95"):
        Recipe(dropout=1.0)
    with pytest.raises(SettingError, match="optimiser 'lbfgs' is not one of sgd, adagrad, adadelta"):
        Recipe("lbfgs")  # type: ignore[arg-type]
    with pytest.raises(SettingError, match="device 'abacus' cannot be used here"):
        device_of("abacus")
    with pytest.raises(SettingError, match="training diverged in epoch 1"):
        trained(replace(BATCHED, learning_rate=100.0, optimiser="sgd"), FlatNetwork("lstm", 8))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
def test_training_on_a_gpu_converges():
    for batch in (1, 64):
        fitted = trained(replace(BATCHED, epochs=20 if batch > 1 else 1, batch=batch, device="cuda"))
        assert fitted.validation.min() < 3.0 * 0.05**2
