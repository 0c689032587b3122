"""Pairs of files from physical laws that the law under test describes only roughly."""

import numpy as np
import torch

from acquisition import Ping, Recording
from noise.discrepancy.moments.sample import Sample
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.physical import PhysicalModel

torch.set_num_threads(1)
TRUTH = {
    "sensitivity": {"loss_db": 22.0},
    "travel_time_jitter": {"sigma_m": 0.004},
    "beam_width": {"ka": 6.0},
    "air_absorption": {"alpha_db_per_m": 1.0},
    "specular_loss": {"strength": 1.0},
    "spike": {"probability": 0.01},
}
ROUGH = {
    "sensitivity": {"loss_db": 18.0},
    "travel_time_jitter": {"sigma_m": 0.005},
    "beam_width": {"ka": 4.8},
    "specular_loss": {"strength": 0.7},
    "clock_scale": {"error": 0.002},
    "spike": {"probability": 0.005},
}


def model(effects):
    return PhysicalModel([CATALOGUE[name](**values) for name, values in effects.items()])


def survey(rng, visits=40, pings=10, aliased=False, distances=(0.3, 4.0)):
    """Return a survey in random order, or from soft to hard targets."""
    distance, angle = rng.uniform(*distances, visits), np.deg2rad(rng.choice([0.0, 5.0, 10.0, 20.0], visits))
    reflectance = rng.choice([0.3, 0.6, 0.9], visits)
    order = np.argsort(reflectance, kind="stable") if aliased else rng.permutation(visits)
    row = np.repeat(order, pings)
    time = np.arange(len(row)) * 0.1 + np.repeat(np.arange(visits), pings) * 5.0
    run = np.arange(len(row)) * 2 // len(row)
    return Ping.of(distance[row], angle[row], reflectance=reflectance[row], time=time, run=run)


def record(law, ping, rng, pings=10, placement=0.003):
    """Return readings of targets that are misplaced by a normal offset in each visit."""
    offset = np.repeat(rng.normal(0.0, placement, len(ping) // pings), pings)
    conditions = {"reflectance": ping.reflectance, "time": ping.time, "run": ping.run}
    placed = Ping.of(np.maximum(ping.distance + offset, 0.05), ping.angle, **conditions)
    return Batch.of(Recording.of(ping, law.law(placed).sample(rng)))


def pair(rng, change=None, same=False, **design):
    """Return a recording, changed in its effects, and a simulation."""
    pings = design.get("pings", 10)
    recorded, simulated = survey(rng, **design), survey(rng, **design)
    changed = {name: {**TRUTH.get(name, {}), **(change or {}).get(name, {})} for name in {**TRUTH, **(change or {})}}
    other = recorded if same else simulated
    return Sample(record(model(changed), recorded, rng, pings), record(model(TRUTH), other, rng, pings))
