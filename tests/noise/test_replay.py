"""Readings of a simulator with differences applied: what differs changes, everything else remains."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import EchoStatus, Ping, Reading, Recording
from noise import GaussianModel, load_model, save_model
from noise.composed import ComposedModel, with_differences
from noise.law import EchoLaw
from noise.replay import Replay, corrected_readings, with_simulated

OTHER = GaussianModel(0.002, 0.0)
N = 4000
PING = Ping.of(distance=np.linspace(0.5, 4.0, N))


def acting(before=None, step=0.001, **causes):
    """Return a model in which causes act on given readings."""
    return with_differences(Replay(OTHER, step, 0.001), before or {}, causes)[0]


def applied(model, reading, ping=PING, seed=0):
    return model.law(with_simulated(ping, reading)).sample(np.random.default_rng(seed))


@given(st.lists(st.integers(1, 11_000), min_size=1, max_size=20), st.integers(0, 2**32 - 1))
def test_without_differences_every_reading_remains(steps, seed):
    steps = np.array(steps)
    status = np.random.default_rng(seed).integers(0, 3, len(steps))
    given_ = Reading.of(np.where(status == EchoStatus.ECHO, steps * 0.001, 0.0), status)
    drawn = applied(acting(), given_, Ping.of(distance=np.full(len(steps), 1.0)), seed)
    np.testing.assert_array_equal(drawn.status, given_.status)
    np.testing.assert_allclose(drawn.range, given_.range, atol=1e-9)


def test_an_offset_moves_each_reading_by_itself():
    """Errors of the law that stands for the simulator do not enter: these readings are 0.2 m from what it expects."""
    given_ = Reading.of(np.round(PING.distance + 0.2, 3))
    drawn = applied(acting(zero_offset={"offset_m": 0.012}), given_)
    np.testing.assert_allclose(drawn.range - given_.range, 0.012, atol=1e-9)


def test_a_clock_that_the_simulation_shares_in_part_stretches_by_the_ratio():
    drawn = applied(
        acting({"clock_scale": {"error": 0.01}}, clock_scale={"error": 0.03}), Reading.of(np.round(PING.distance, 3))
    )
    np.testing.assert_allclose(drawn.range, PING.distance * 1.03 / 1.01, atol=1.6e-3)  # three roundings


def test_lost_readings_are_lost_from_those_that_were_heard():
    heard = np.arange(N) % 4 != 0
    drawn = applied(
        acting(dropped_reading={"probability": 0.3}), Reading.of(np.where(heard, np.round(PING.distance, 3), 0.0))
    )
    assert not drawn.echo[~heard].any()
    assert drawn.echo[heard].mean() == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / heard.sum()))
    np.testing.assert_allclose(drawn.range[drawn.echo], np.round(PING.distance, 3)[drawn.echo], atol=1e-9)


def test_echoes_that_become_audible_have_the_range_that_the_other_law_expects():
    had, now = {"sensitivity": {"loss_db": 57.0}}, {"loss_db": 48.0}
    drawn = applied(acting(had, sensitivity=now), Reading.of(np.zeros(N)))
    far = PING.distance > 2.0
    assert drawn.echo[far].mean() > 0.2
    error = (drawn.range - PING.distance)[drawn.echo]
    assert abs(error.mean()) < 5 * 0.002 / np.sqrt(len(error)) + 0.0005
    assert error.std() == pytest.approx(0.002, rel=0.15)


def test_a_coarse_register_hides_where_within_a_step_the_echo_was():
    """A reading of 1.20 m on steps of 0.10 m may have been anywhere in 1.15 to 1.25 m."""
    given_ = Reading.of(np.full(N, 1.2))
    drawn = applied(acting(step=0.1, zero_offset={"offset_m": 0.03}), given_, Ping.of(distance=np.full(N, 1.2)))
    assert drawn.range.min() == pytest.approx(1.18, abs=2e-3)
    assert drawn.range.max() == pytest.approx(1.28, abs=2e-3)
    assert drawn.range.mean() == pytest.approx(1.23, abs=4 * 0.1 / np.sqrt(12 * N))


def test_without_readings_of_the_simulator_the_other_model_stands_for_it():
    model = acting(zero_offset={"offset_m": 0.05})
    assert model.law(Ping.of(distance=[1.0])).quantile(0.5)[0] == pytest.approx(1.05, abs=0.0015)


@pytest.mark.filterwarnings("ignore:the law extrapolates")
def test_only_a_range_that_the_other_law_gives_is_extrapolated():
    ping = Ping.of(distance=[1.0, 1.0, 1.0], temperature_c=[80.0, 80.0, 20.0])
    law = Replay(load_model("srf08-mlp"), 0.01, 0.01).law(with_simulated(ping, Reading.of([1.0, 0.0, 0.0])))
    assert law.extrapolates.tolist() == [False, True, False]


def test_a_saved_model_acts_alike(tmp_path):
    model = acting(zero_offset={"offset_m": 0.012}, stale_repeat={"probability": 0.2})
    loaded = load_model(save_model(model, tmp_path / "difference"))
    assert isinstance(loaded, ComposedModel)
    given_ = Reading.of(np.round(PING.distance, 3))
    np.testing.assert_array_equal(applied(loaded, given_).range, applied(model, given_).range)


def test_a_corrected_recording_keeps_all_that_is_no_reading():
    rng = np.random.default_rng(0)
    ping = Ping.of(distance=rng.uniform(0.5, 2.0, 50), temperature_c=np.full(50, 20.0))
    reading = Reading.of(np.round(ping.distance, 3))
    simulated = Recording.of(ping, reading, echo_2_mm=np.full(50, 3000.0), note=["a"] * 50)
    corrected = corrected_readings(acting(zero_offset={"offset_m": 0.01}), simulated, rng)
    kept = [name for name in simulated.table.columns if name not in ("reading_mm", "echo_2_mm")]
    pd.testing.assert_frame_equal(corrected.table[kept], simulated.table[kept])
    np.testing.assert_allclose(corrected.reading.range - reading.range, 0.01, atol=1e-9)
    assert not corrected.has("echo_2_mm")


class Deaf(EchoLaw):
    """Echoes at 1 m, with the least probabilities that a float can hold."""

    def _arrival(self, z):
        return np.where(z >= 1.0, np.geomspace(5e-324, 1e-300, len(self.distance)), 0.0)

    @property
    def no_answer(self):
        return np.zeros(len(self.distance))


class DeafModel(GaussianModel):
    def law(self, ping, past=None):
        return Deaf(ping.distance, self.resolution, self.max_range)


def test_echoes_that_the_other_law_all_but_excludes_have_no_range():
    """The quotients of the least numbers overflow."""
    silent = with_simulated(PING, Reading.of(np.zeros(N)))
    offset = {"zero_offset": {"offset_m": 0.01}}
    with np.errstate(over="raise", invalid="raise"):
        law = with_differences(Replay(DeafModel(), 0.001, 0.001), {}, offset)[0].law(silent)
        assert np.isfinite(law.echo).all()
