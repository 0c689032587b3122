"""The emulator against simulators that are no stack of its own effects."""

import numpy as np

from acquisition import Ping, Reading, Recording
from noise.discrepancy.baseline.emulator import base_physics
from noise.discrepancy.name.candidates import shows
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.metrics import crps_with_silence
from training.diagnosis.generators.rays import RaySonar


def rays(n_visits, seed, pings=8):
    """Return a survey with a fan of 21 rays over 26 deg, a plate 0.5 m wide, and nothing behind it."""
    rng = np.random.default_rng(seed)
    sonar = RaySonar(13.0, 21, 0.25, 20.0, 0.004, 0.0, 45.0, 0.0)
    angle, distance = rng.uniform(-0.7, 0.7, n_visits), rng.uniform(0.4, 4.0, n_visits)
    once = Ping.of(distance, angle=angle, incidence=rng.choice([0.0, 0.2, -0.2], n_visits))
    every = once[np.repeat(np.arange(n_visits), pings)]
    every, value = sonar.read(every, rng)
    return Batch.of(Recording.of(every, Reading.of(np.round(value, 3))))


def test_a_simulator_of_rays_is_described_where_it_has_not_been():
    law = base_physics(rays(120, seed=1), np.random.default_rng(2)).single_ping_model
    fresh = rays(60, seed=3)
    heard = law.law(fresh.ping, fresh.past).echo
    assert 0.2 < fresh.reading.echo.mean() < 0.9
    assert np.mean((heard - fresh.reading.echo) ** 2) < 0.03
    crps = crps_with_silence(law.law(fresh.ping, fresh.past), fresh.reading)
    assert np.median(crps) < 0.006


def test_what_only_simulators_have_is_no_cause():
    assert not shows(CATALOGUE["ray_cone"], rays(10, seed=1))
