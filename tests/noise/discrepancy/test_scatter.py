"""Scatter of single readings: named where the simulation has another, and only there."""

import numpy as np
import pytest
import torch

from acquisition import Ping, Recording
from noise.discrepancy import diagnose
from noise.effects import CATALOGUE
from noise.model import IdealModel, simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)


def heard(seed, sigma_m):
    """Return 50 cells of 8 pings, placed to 3 mm, read with a scatter of its own."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.4, 3.0, 50), 8)
    placed = distance + np.repeat(rng.normal(0, 0.003, 50), 8)
    model = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=sigma_m)])
    return Recording.of(Ping.of(distance=distance), simulate(model, Ping.of(distance=placed), rng))


@pytest.mark.parametrize("sigma_m", [0.002, 0.006])
def test_scatter_is_named_where_it_differs_and_only_there(sigma_m):
    found = diagnose(IdealModel(), heard(1, sigma_m), simulated=heard(2, 0.002), seed=3)
    verdict = found.to_verdict()
    if sigma_m == 0.002:
        assert verdict["verdict"] == "none"
    else:
        assert [effect["effect"] for effect in verdict["effects"]] == ["travel_time_jitter"]
        assert verdict["effects"][0]["parameters"]["sigma_m"]["value"] == pytest.approx(sigma_m, rel=0.15)
        assert verdict["held_out"]["gain_per_ping_low"] > 0
