"""A beat among the residuals: found with period and size where there is one, and nowhere else."""

import numpy as np
import pytest
from scipy import stats

from acquisition import Ping, Reading, Recording
from noise.discrepancy.checks.rhythm import Beat, rhythm
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack

STACK = Stack({"travel_time_jitter": {"sigma_m": 0.004}, "visits": {"placement_m": 0.003}})


def recording(seed, wave=lambda t: 0.0 * t, carry=0.0, cells=40, pings=25):
    """Cells of a few seconds each, 20 s apart, with placement scatter and readings that drag on."""
    rng = np.random.default_rng(seed)
    n = cells * pings
    time = np.repeat(np.arange(cells) * (20.0 + 0.1 * pings), pings) + np.tile(0.1 * np.arange(pings), cells)
    time += rng.normal(0, 0.004, n)
    distance = np.repeat(np.round(rng.uniform(0.3, 4.0, cells), 3), pings)
    noise = rng.normal(0, 0.004, n)
    for k in range(1, n):
        noise[k] = carry * noise[k - 1] + np.sqrt(1 - carry**2) * noise[k]
    error = np.repeat(rng.normal(0, 0.003, cells), pings) + noise + wave(time)
    ping = Ping.of(distance=distance, time=np.round(time, 3))
    return Batch.of(Recording.of(ping, Reading.of(np.round(distance + error, 3))))


@pytest.mark.parametrize("hertz", [0.37, 1.3, 50.03])
def test_a_wave_is_found_with_its_period_and_size(hertz):
    found = rhythm(STACK, recording(1, lambda t: 0.006 * np.sin(2 * np.pi * hertz * t)))
    assert found.p_value < 1e-3
    assert 1.0 / found.period_s == pytest.approx(hertz, rel=0.002)
    assert found.amplitude_m == pytest.approx(0.006, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("carry", [0.0, 0.9])
def test_no_wave_no_beat_however_readings_drag_on(carry):
    p = [rhythm(STACK, recording(100 + k, carry=carry)).p_value for k in range(60)]
    assert min(p) > 1e-3
    assert stats.kstest(p, "uniform", alternative="greater").pvalue > 1e-3  # too large, if anything


def test_a_slow_drift_is_no_beat():
    found = rhythm(STACK, recording(5, lambda t: 2e-5 * t))
    assert found.p_value > 1e-3


def test_times_on_a_lattice_tell_the_slowest_wave_that_fits():
    # at exactly ten pings a second, 10.5 Hz looks like 0.5 Hz, and nothing above 5 Hz can be told
    time = np.repeat(np.arange(40) * 24.0, 40) + np.tile(0.1 * np.arange(40), 40)
    wave = np.sin(2 * np.pi * 10.5 * time)
    found = Beat(time, wave, 0.005 * wave, np.repeat(np.arange(40), 40)).strongest(5.0)
    assert 1.0 / found.period_s == pytest.approx(0.5, rel=0.01)


def test_without_times_nothing_is_said():
    batch = recording(1)
    assert rhythm(STACK, Batch.of(Recording(_without_time(batch)))) is None


def _without_time(batch):
    table = Recording.of(batch.ping, batch.reading).table
    return table.drop(columns=["time_s"])


def test_readings_that_never_change_have_no_beat():
    still = recording(7)
    reading = Reading.of(np.repeat(still.reading.range[np.unique(still.first)], 25))
    batch = Batch.of(Recording.of(still.ping, reading))
    assert rhythm(STACK, batch).p_value == 1.0
