"""Recordings made by a known law, with targets placed a little off their marks."""

from functools import cache

import numpy as np

from acquisition import Ping, Recording
from noise.discrepancy.name.folds import Folds
from noise.discrepancy.name.search import Search
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.stack import VISITS, Stack
from noise.model import simulate
from noise.physical import PhysicalModel

USUAL = {
    "travel_time_jitter": {"sigma_m": 0.002},
    "sensitivity": {"loss_db": 38.0},
    "beam_width": {"ka": 2.0},
    "specular_loss": {"strength": 0.7},
}
PLACEMENT_M = 0.002
CHANGES = {
    "sound_speed": {"sound_speed": {"temperature_c": 31.0}},
    "zero_offset": {"zero_offset": {"offset_m": 0.012}},
    "dropped_reading": {"dropped_reading": {"probability": 0.08}},
    "time_walk": {"time_walk": {"scale": 1.0}},
    "spike": {"spike": {"probability": 0.05}},
    "fixed_clutter": {"fixed_clutter": {"presence": 0.3, "range_m": 0.9, "spread_m": 0.01}},
    "sensitivity": {"sensitivity": {"loss_db": 43.0}},
    "noise_burst": {"noise_burst": {"probability": 0.1, "sigma_m": 0.08}},
}


def model_of(changed=None):
    """Return the usual sonar with changed effects."""
    values = {**USUAL, **{name: {**USUAL.get(name, {}), **inner} for name, inner in (changed or {}).items()}}
    return PhysicalModel([CATALOGUE[name](**inner) for name, inner in values.items()])


def recording_of(changed=None, seed=0, visits=90, pings=12, wait_s=20.0):
    """Return a survey with the usual sonar, or with one in which effects are changed."""
    rng = np.random.default_rng(seed)
    n = visits * pings
    distance = np.repeat(np.round(rng.uniform(0.3, 3.5, visits), 3), pings)
    angle = np.repeat(np.round(rng.uniform(-0.5, 0.5, visits), 3), pings)
    reflectance = np.repeat(rng.choice([0.1, 0.9], visits), pings)
    time = np.round(np.cumsum(np.where(np.arange(n) % pings == 0, wait_s, 0.1)), 3)
    ping = Ping.of(distance=distance, angle=angle, incidence=angle, reflectance=reflectance, time=time)
    moved = np.repeat(rng.normal(0.0, PLACEMENT_M, visits), pings)
    true = Ping.of(distance=distance + moved, angle=angle, incidence=angle, reflectance=reflectance, time=time)
    return Recording.of(ping, simulate(model_of(changed), true, rng))


def batch_of(changed=None, seed=0, **survey):
    """Return the readings of `recording_of`."""
    return Batch.of(recording_of(changed, seed, **survey))


def law_of():
    """Return the law of the usual sonar with its placement."""
    return Stack.of(model_of()).put([(VISITS, "placement_m")], [PLACEMENT_M])


def search_of(changed, seed=3, simulated=None, law=None, without=(), **survey):
    """Return a search in a recording with changes of the law."""
    batch = batch_of(changed, seed, **survey)
    folds = Folds.of(batch, np.random.default_rng(seed))
    return Search(law_of() if law is None else law, folds, simulated, np.random.default_rng(seed), without)


@cache
def found_of(name):
    """Return the search for one change, and what it found; made once, since it takes seconds."""
    search = search_of(CHANGES[name])
    return search, search.run()[1]
