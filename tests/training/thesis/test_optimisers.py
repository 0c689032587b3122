"""Each optimiser in three implementations: formulas of Keras 1, torch with the thesis's settings, and compiled."""

import json
import math

import h5py
import numpy as np
import pytest
import torch

from training.thesis.fit import OPTIMISERS, Recipe
from training.thesis.networks import FlatNetwork
from training.thesis.online import GRADIENTS, RULES, learn


class Keras1:
    """The rules of Keras 1.0.8 in double precision, from its documentation and the thesis's section 2.2.3.

    Attributes:
        a, b: accumulators of a rule.
    """

    def __init__(self, size):
        self.a, self.b, self.t, self.schedule = np.zeros(size), np.zeros(size), 0, 1.0

    def sgd(self, g):
        return 0.01 * g

    def adagrad(self, g):
        self.a += g**2
        return 0.01 * g / (np.sqrt(self.a) + 1e-8)

    def rmsprop(self, g):
        self.a = 0.9 * self.a + 0.1 * g**2
        return 0.001 * g / (np.sqrt(self.a) + 1e-8)

    def adadelta(self, g):
        self.a = 0.95 * self.a + 0.05 * g**2
        step = g * np.sqrt(self.b + 1e-8) / np.sqrt(self.a + 1e-8)
        self.b = 0.95 * self.b + 0.05 * step**2
        return step

    def adam(self, g):
        self.t += 1
        self.a, self.b = 0.9 * self.a + 0.1 * g, 0.999 * self.b + 0.001 * g**2
        rate = 0.001 * math.sqrt(1 - 0.999**self.t) / (1 - 0.9**self.t)
        return rate * self.a / (np.sqrt(self.b) + 1e-8)

    def nadam(self, g):
        self.t += 1
        now, soon = (0.9 * (1 - 0.5 * 0.96 ** (0.004 * t)) for t in (self.t, self.t + 1))
        self.schedule *= now
        self.a, self.b = 0.9 * self.a + 0.1 * g, 0.999 * self.b + 0.001 * g**2
        ahead = (1 - now) * g / (1 - self.schedule) + soon * self.a / (1 - self.schedule * soon)
        return 0.002 * ahead / (np.sqrt(self.b / (1 - 0.999**self.t)) + 1e-8)


@pytest.mark.parametrize("name", OPTIMISERS)
def test_torch_s_rules_with_the_thesis_s_settings_agree_with_keras(name):
    rng = np.random.default_rng(0)
    here = rng.normal(size=30)
    theta, keras = torch.tensor(here.copy(), requires_grad=True), Keras1(30)
    rule, path = OPTIMISERS[name].of(theta), here.copy()
    for _ in range(300):
        gradient = rng.normal(size=30) * 10.0 ** rng.uniform(-3, 0, 30)
        theta.grad = torch.tensor(gradient)
        rule.step()
        path -= getattr(keras, name)(gradient)
    moved = np.abs(path - here).max()
    assert np.abs(theta.detach().numpy() - path).max() < 1e-4 * moved  # the difference in Adam's epsilon


@pytest.mark.parametrize("kind", GRADIENTS)
@pytest.mark.parametrize("name", OPTIMISERS)
def test_compiled_steps_agree_with_torch(name, kind):
    rng = np.random.default_rng(4)
    network, steps = FlatNetwork(kind, 7), 120
    first = network.initial(rng)
    feature, label = rng.random((steps, 4), dtype=np.float32), rng.random(steps, dtype=np.float32)
    dropout_mask = ((rng.random((steps, 7)) < 0.8) / 0.8).astype(np.float32)
    recipe = Recipe(name, l1=1e-3, l2=2e-3)
    penalty, order = recipe.penalty(network), rng.permutation(steps)

    compiled = first.copy()
    mean_loss = learn(
        *(GRADIENTS[kind], RULES[name], compiled, np.zeros((2, network.size), np.float32), np.array([0.0, 1.0])),
        *(OPTIMISERS[name].values(), feature, label, order, dropout_mask, penalty),
    )
    theta = torch.tensor(first, requires_grad=True)
    rule, losses = OPTIMISERS[name].of(theta), []
    x, y, mask, lasso = map(torch.from_numpy, (feature, label, dropout_mask, penalty))
    for step, row in enumerate(order):
        rule.zero_grad()
        loss = ((network.output(theta, x[row : row + 1], mask[step : step + 1]) - y[row]) ** 2).sum()
        (loss + lasso[0] @ theta.abs() + lasso[1] @ theta**2).backward()
        rule.step()
        losses.append(float(loss.detach()))
    there = theta.detach().numpy()
    assert np.abs(there - first).max() > 0.01
    assert mean_loss == pytest.approx(np.mean(losses), rel=1e-4)
    np.testing.assert_allclose(compiled, there, atol=1e-4)


def test_nadam_s_settings_are_those_of_the_published_networks(real_recordings):
    path = real_recordings.parent / "thesis" / "mlp_nadam_25_15_1_my_model.h5"
    if not path.exists():
        pytest.skip(f"no published networks at {path.parent}")
    with h5py.File(path) as file:
        config = json.loads(file.attrs["training_config"])["optimizer_config"]["config"]
    settings = OPTIMISERS["nadam"].settings
    published = config["lr"], config["beta_1"], config["beta_2"], config["epsilon"], config["schedule_decay"]
    assert published == pytest.approx((settings["lr"], *settings["betas"], settings["eps"], settings["momentum_decay"]))
