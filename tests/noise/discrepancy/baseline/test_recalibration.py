"""A recalibrated law: calibrated where the law is not, the law itself where that is right, in a file as in memory."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import ModelError, Ping, Reading, Recording
from noise import GaussianModel, load_model, save_model
from noise.discrepancy.baseline.recalibration import recalibrated, transforms
from noise.discrepancy.judge.held_out import fair_crps
from noise.fitting.batch import Batch
from noise.metrics import crps_with_silence
from noise.model import MAX_RANGE, simulate

LAW = GaussianModel(0.005, 0.0, 0.0)
PINGS = 6


def survey(n=80, seed=0):
    """Return n places with `PINGS` pings each."""
    rng = np.random.default_rng(seed)
    distance, angle = rng.uniform(0.3, 4.0, n), rng.choice([0.0, 0.2, 0.4], n)
    time = np.arange(n * PINGS) * 0.1
    return Ping.of(
        distance=np.repeat(distance, PINGS),
        angle=np.repeat(angle, PINGS),
        incidence=0.0,
        reflectance=0.9,
        time=time,
        run=np.repeat(np.arange(n), PINGS),
    )


def batch_of(change=lambda ping, reading, rng: reading, seed=0, n=80):
    """Return readings of the law with a change."""
    ping, rng = survey(n, seed), np.random.default_rng([seed, 1])
    return Batch.of(Recording.of(ping, change(ping, LAW.law(ping).sample(rng), rng)))


def turned(ping):
    return ping.angle > 0.3


def longer(ping, reading, rng):
    return Reading.of(np.where(reading.echo, reading.range + 0.03 * turned(ping), 0.0))


def lost(ping, reading, rng):
    return Reading.of(np.where(rng.random(len(ping)) < 0.5 * turned(ping), 0.0, reading.range))


def early(ping, reading, rng):
    hit = (rng.random(len(ping)) < 0.4 * turned(ping)) & reading.echo
    return Reading.of(np.where(hit, np.round(0.6 * reading.range, 3), reading.range))


def first_of_visit(ping, reading, rng):
    place = np.arange(len(ping)) % PINGS
    return Reading.of(np.where(reading.echo, reading.range + 0.03 * (place == 0), 0.0))


def mean_crps(law, batch):
    return float(np.mean(crps_with_silence(law, batch.reading)))


def closed(model, change):
    """Return the share of the gap between the law and the sonar itself that a model closes under new conditions."""
    fresh, rng = batch_of(change, seed=7), np.random.default_rng(9)
    drawn = [change(fresh.ping, LAW.law(fresh.ping).sample(rng), rng) for _ in range(60)]
    members = np.stack([np.where(each.echo, each.range, MAX_RANGE) for each in drawn], axis=1)
    least = fair_crps(np.where(fresh.reading.echo, fresh.reading.range, MAX_RANGE), members).mean()
    before, after = (mean_crps(m.law(fresh.ping, fresh.past), fresh) for m in (LAW, model))
    return (before - after) / (before - least)


@pytest.mark.parametrize("change", [longer, lost, early, first_of_visit])
def test_what_no_law_names_is_learned_and_holds_at_new_distances(change):
    found = recalibrated(LAW, batch_of(change, n=160), np.random.default_rng(0))
    assert closed(found.model, change) > 0.75


def test_a_law_that_is_right_is_hardly_changed():
    found, fresh = recalibrated(LAW, batch_of(), np.random.default_rng(0)), batch_of(seed=7)
    if found is not None:
        before, after = (mean_crps(m.law(fresh.ping, fresh.past), fresh) for m in (LAW, found.model))
        assert after < 1.01 * before


def test_the_share_is_that_of_least_crps_on_visits_that_trees_lack():
    batch = batch_of(longer)
    found = recalibrated(LAW, batch, np.random.default_rng(0))
    scores = {share: mean_crps(found.crossed.pooled(share), found.batch) for share in (0.0, 0.25, 0.5, 0.75, 1.0)}
    assert mean_crps(found.crossed, found.batch) <= min(scores.values()) + 1e-6


def test_a_pool_without_a_share_is_the_law_itself():
    found = recalibrated(LAW, batch_of(longer), np.random.default_rng(0))
    law, z = LAW.law(found.batch.ping), np.linspace(0.2, 4.5, 40)[:, None]
    np.testing.assert_array_equal(found.crossed.pooled(0.0).arrival(z), law.arrival(z))
    assert mean_crps(found.crossed.pooled(0.0), found.batch) == pytest.approx(mean_crps(law, found.batch))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_transforms_enclose_probabilities_that_sum_to_one(seed):
    ping, rng = survey(4, seed % 7), np.random.default_rng(seed)
    law = LAW.law(ping)
    low, high = transforms(law, law.sample(rng))
    assert ((low >= 0.0) & (low <= high) & (high <= 1.0)).all()
    silent = transforms(law, Reading.of(np.zeros(len(ping))))
    np.testing.assert_allclose(silent[1] - silent[0], law.no_echo, atol=1e-12)


def test_the_recalibrated_law_is_a_law():
    model, ping = recalibrated(LAW, batch_of(early), np.random.default_rng(0)).model, survey(10, 3)
    law, z = model.law(ping), np.sort(np.random.default_rng(0).uniform(0.0, 12.0, (60, len(ping))), axis=0)
    arrival = law.arrival(z)
    assert (np.diff(arrival, axis=0) >= -1e-12).all()
    assert ((arrival >= 0.0) & (arrival <= 1.0 + 1e-12)).all()
    drawn = [law.sample(np.random.default_rng(k)) for k in range(200)]
    share = np.mean([each.echo for each in drawn])
    assert share == pytest.approx(law.echo.mean(), abs=4 * np.sqrt(0.25 / (200 * len(ping))))


def test_a_saved_model_is_the_same_law(tmp_path):
    model, ping = recalibrated(LAW, batch_of(early), np.random.default_rng(0)).model, survey(5, 3)
    again = load_model(save_model(model, tmp_path / "model"))
    z = np.linspace(0.1, 5.0, len(ping))
    np.testing.assert_allclose(again.law(ping).arrival(z), model.law(ping).arrival(z), atol=1e-12)


@pytest.mark.parametrize(
    "damage",
    [{"low": [0.0]}, {"share": 1.5}, {"leaf": [[0]]}, {"error": [3.0, 1.0]}, {"names": []}, {"model": {"kind": "x"}}],
)
def test_a_damaged_file_is_a_clear_error(tmp_path, damage):
    folder = save_model(recalibrated(LAW, batch_of(early), np.random.default_rng(0)).model, tmp_path / "model")
    data = json.loads((folder / "model.json").read_text())
    (folder / "model.json").write_text(json.dumps(data | damage))
    with pytest.raises(ModelError, match=r"model\.json"):
        load_model(folder)


def test_a_model_that_forgets_draws_a_reading_for_every_ping():
    model = recalibrated(LAW, batch_of(longer), np.random.default_rng(0)).model
    assert simulate(model, survey(3, 2), np.random.default_rng(0)).answered.all()
