"""How long the thesis's training takes: online, compiled and by torch, and in mini-batches to the same quality.

The thesis: a network of 30 neurons, 20 online passes over 123,100 pings with Nadam, 13.3 minutes (listing A.1).
Run by `make benchmarks`; prints Markdown for docs/thesis-training.md. Both ways are timed in turn on the same pings.
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
from training.recordings import record
from training.thesis.data import VALIDATION_SHARE, Samples
from training.thesis.fit import BATCHED, Recipe, fit
from training.thesis.networks import Network
from training.thesis.numbers import A1_MINUTES
from training.thesis.optimisers import OPTIMISERS
from training.thesis.page import markdown

NETWORK, ONLINE, ROUNDS, LIMIT_S = Network("mlp", 30), Recipe(epochs=20), 3, 15.0
TORCH_STEPS = 3000


@pytest.fixture(scope="module", params=(14, 31), ids=lambda gain: f"gain {gain}")
def samples(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Samples:
    """The thesis's survey by the rig, at the thesis's gain and at full gain; kept in SONAR_GYM_SURVEYS where set."""
    folder = Path(os.environ.get("SONAR_GYM_SURVEYS") or tmp_path_factory.mktemp("surveys"))
    path = folder / f"thesis-gain-{request.param}.csv"
    if not path.exists():
        record.main(record.Args(path, driver="rig", plan="thesis", seed=1, gain=request.param))
    print(f"\n{request.node.name}: {path.name}, commit {commit()}, one thread")
    return Samples.of(Recording.load(path))


def torch_seconds(samples: Samples) -> float:
    """Return how long 20 online passes would take by torch on one thread, from a few thousand steps of them."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    theta = torch.tensor(NETWORK.first(np.random.default_rng(0)), requires_grad=True)
    feature, label = torch.from_numpy(samples.feature), torch.from_numpy(samples.label)
    optimiser, start = OPTIMISERS["nadam"].of(theta), time.perf_counter()
    for row in range(TORCH_STEPS):
        optimiser.zero_grad()
        keep = (torch.rand(1, NETWORK.hidden) >= ONLINE.dropout) / (1.0 - ONLINE.dropout)
        ((NETWORK.output(theta, feature[row : row + 1], keep) - label[row]) ** 2).sum().backward()
        optimiser.step()
    torch.set_num_threads(before)
    return (time.perf_counter() - start) / TORCH_STEPS * ONLINE.epochs * len(samples) * (1.0 - VALIDATION_SHARE)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_batches_reach_the_quality_of_twenty_online_passes(samples: Samples) -> None:
    rows: list[tuple[object, ...]] = []
    waits: list[float] = []
    for seed in range(ROUNDS):
        rng = np.random.default_rng(seed)
        train, validation = samples.split(rng)
        online = fit(NETWORK, train, validation, ONLINE, np.random.default_rng(seed))
        batched = fit(NETWORK, train, validation, BATCHED, np.random.default_rng(seed))
        reached = np.flatnonzero(batched.validation <= online.validation.min())
        waits.append(batched.seconds[reached[0]] if len(reached) else np.inf)
        losses = [f"{fitted.validation.min():.5f}" for fitted in (online, batched)]
        seconds = [f"{x:.1f}" for x in (online.seconds[-1], waits[-1], batched.seconds[-1])]
        rows.append((seed, *losses, *seconds))
    heading = "seed|best loss, 20 online passes|best loss, mini-batches|online, compiled (s)|batches until as good (s)"
    print(markdown((*heading.split("|"), f"batches, all {BATCHED.epochs} passes (s)"), rows))
    floor = f"no function of the inputs gets below {samples.floor():.5f}"
    print(f"\nby torch, a step a ping: {torch_seconds(samples):.0f} s; the thesis: {60 * A1_MINUTES:.0f} s; {floor}")
    assert max(waits) <= LIMIT_S


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_pass_of_each_network(samples: Samples) -> None:
    rows = []
    for network in (*(Network("mlp", hidden) for hidden in (10, 15, 20, 25, 30)), Network("lstm", 25)):
        for name in ("sgd", "nadam"):
            recipe = replace(ONLINE, optimiser=name, epochs=3)
            fitted = fit(network, samples, samples[np.arange(1000)], recipe, np.random.default_rng(0))
            seconds = float(np.median(np.diff(fitted.seconds, prepend=0.0)))
            rows.append((network.kind, network.hidden, name, f"{seconds:.2f}", f"{1e6 * seconds / len(samples):.2f}"))
    print("\n" + markdown(("network", "units", "optimiser", "s a pass", "us a ping"), rows))
    assert all(float(row[-1]) < 200.0 for row in rows)
