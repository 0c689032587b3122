"""Scatter of single readings: named where the simulation has another, and only there."""

import numpy as np
import pytest
import torch

from acquisition import Ping, Reading, Recording
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


@pytest.mark.slow
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


def stays(seed, flutter_s, bursts=0.0):
    """Return 48 stays of 12 pings whose readings flutter by 2 mm, slowly or fast; a share of them burst by 0.15 m."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(rng.uniform(0.4, 3.0, 48), 12)
    time = np.arange(len(distance)) * 0.1 + np.repeat(60.0 * np.arange(48), 12)
    offset = np.repeat(rng.normal(0, 0.003, 48), 12) + rng.normal(0, 0.0005, len(distance))
    wave, steady = 0.0, np.exp(-0.1 / flutter_s)
    for k in range(len(distance)):
        keep = 0.0 if k % 12 == 0 else steady
        wave = keep * wave + np.sqrt(1.0 - keep**2) * rng.normal(0, 0.002)
        offset[k] += wave + (rng.normal(0, 0.15) if rng.random() < bursts else 0.0)
    return Recording.of(Ping.of(distance=distance, time=time), Reading.of(np.round(distance + offset, 4)))


@pytest.mark.slow
def test_bursts_are_not_taken_for_scatter():
    verdict = diagnose(IdealModel(), stays(1, 2.0, 0.12), simulated=stays(2, 2.0), seed=1).to_verdict()
    assert [effect["effect"] for effect in verdict["effects"]] == ["noise_burst"]
    burst = verdict["effects"][0]["parameters"]
    assert burst["probability"]["value"] == pytest.approx(0.12, abs=0.06)
    assert burst["sigma_m"]["value"] == pytest.approx(0.15, abs=0.05)
    held = verdict["held_out"]
    assert held["after"]["log_likelihood_per_ping"] > held["before"]["log_likelihood_per_ping"] + 0.05


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_air_that_flutters_faster_than_on_the_day_of_the_simulation_is_no_mismatch(seed):
    verdict = diagnose(IdealModel(), stays(10 + seed, 0.5), simulated=stays(20 + seed, 10.0), seed=seed).to_verdict()
    assert verdict["verdict"] == "none"
