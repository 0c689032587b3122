"""Duration of the thesis's training: online, compiled and by torch, and in mini-batches to the same loss.

The thesis: a network of 30 neurons, 20 online epochs of 123,100 pings with Nadam, 13.3 minutes (listing A.1).
Run by `make benchmarks`; prints Markdown for docs/explanation/thesis-training.md. Both methods are timed in turn on the
same pings.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from acquisition import Recording
from training.common.commit import commit
from training.common.tables import markdown_table
from training.recordings import record
from training.thesis.data import A1_MINUTES, VALIDATION_SHARE, Samples
from training.thesis.fit import OPTIMISERS, Recipe, fit
from training.thesis.networks import FlatNetwork

NETWORK, ONLINE, ROUNDS, LIMIT_S = FlatNetwork("mlp", 30), Recipe(epochs=20), 3, 15.0
# reaches the loss of 20 online epochs; a large learning rate that falls replaces the noise of online steps
BATCHED = Recipe(epochs=45, batch=256, dropout=0.0, learning_rate=0.06, falls_to=0.01)
TORCH_STEPS = 3000


@pytest.fixture(scope="module", params=(14, 31), ids=lambda gain: f"gain {gain}")
def samples(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Samples:
    """The rig's recording of the thesis's survey at the stated and at full gain, stored in SONAR_GYM_SURVEYS if set."""
    folder = Path(os.environ.get("SONAR_GYM_SURVEYS") or tmp_path_factory.mktemp("surveys"))
    path = folder / f"thesis-gain-{request.param}.csv"
    if not path.exists():
        record.main(record.Args(path, driver="rig", plan="thesis", seed=1, gain=request.param))
    print(f"\n{request.node.name}: {path.name}, commit {commit()}, one thread")
    return Samples.of(Recording.load(path))


def torch_seconds(samples: Samples) -> float:
    """Return the duration of 20 online epochs by torch on one thread, extrapolated from `TORCH_STEPS` steps."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    theta = torch.tensor(NETWORK.initial(np.random.default_rng(0)), requires_grad=True)
    feature, label = torch.from_numpy(samples.feature), torch.from_numpy(samples.label)
    optimiser, start = OPTIMISERS["nadam"].of(theta), time.perf_counter()
    for row in range(TORCH_STEPS):
        optimiser.zero_grad()
        dropout_mask = (torch.rand(1, NETWORK.hidden) >= ONLINE.dropout) / (1.0 - ONLINE.dropout)
        ((NETWORK.output(theta, feature[row : row + 1], dropout_mask) - label[row]) ** 2).sum().backward()
        optimiser.step()
    torch.set_num_threads(before)
    return (time.perf_counter() - start) / TORCH_STEPS * ONLINE.epochs * len(samples) * (1.0 - VALIDATION_SHARE)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_mini_batches_reach_the_loss_of_twenty_online_epochs(samples: Samples) -> None:
    rows: list[tuple[object, ...]] = []
    seconds_until_equal: list[float] = []
    for seed in range(ROUNDS):
        rng = np.random.default_rng(seed)
        train, validation = samples.split(rng)
        online = fit(NETWORK, train, validation, ONLINE, np.random.default_rng(seed))
        batched = fit(NETWORK, train, validation, BATCHED, np.random.default_rng(seed))
        reached = np.flatnonzero(batched.validation <= online.validation.min())
        seconds_until_equal.append(batched.seconds[reached[0]] if len(reached) else np.inf)
        losses = [f"{fitted.validation.min():.5f}" for fitted in (online, batched)]
        seconds = [f"{x:.1f}" for x in (online.seconds[-1], seconds_until_equal[-1], batched.seconds[-1])]
        rows.append((seed, *losses, *seconds))
    heading = (
        "seed|best loss, 20 online epochs|best loss, mini-batches|online, compiled (s)|batches, until equal loss (s)"
    )
    print(markdown_table((*heading.split("|"), f"batches, all {BATCHED.epochs} epochs (s)"), rows))
    floor = f"no function of the inputs has a loss below {samples.loss_floor():.5f}"
    print(
        f"\nby torch, one step per ping: {torch_seconds(samples):.0f} s; the thesis: {60 * A1_MINUTES:.0f} s; {floor}"
    )
    assert max(seconds_until_equal) <= LIMIT_S


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_duration_of_an_epoch_of_each_network(samples: Samples) -> None:
    rows = []
    for network in (*(FlatNetwork("mlp", hidden) for hidden in (10, 15, 20, 25, 30)), FlatNetwork("lstm", 25)):
        for name in ("sgd", "nadam"):
            recipe = replace(ONLINE, optimiser=name, epochs=3)
            fitted = fit(network, samples, samples[np.arange(1000)], recipe, np.random.default_rng(0))
            seconds = float(np.median(np.diff(fitted.seconds, prepend=0.0)))
            rows.append((network.kind, network.hidden, name, f"{seconds:.2f}", f"{1e6 * seconds / len(samples):.2f}"))
    print("\n" + markdown_table(("network", "units", "optimiser", "s per epoch", "us per ping"), rows))
    assert all(float(row[-1]) < 200.0 for row in rows)
