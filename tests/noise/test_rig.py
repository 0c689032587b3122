"""The rig as a sonar model: it can be sampled in one batch and has no probabilities."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import EchoStatus, Ping, SonarError
from acquisition.bench import Bus, Rig, Setup, Unit
from acquisition.errors import SampleOnlyError
from noise import CredenceTable, SonarModel, load_model, simulate
from noise.rig import SIMULATED, RigModel


def conditions(n, seed=0):
    rng = np.random.default_rng(seed)
    angles = np.deg2rad(rng.uniform(-25.0, 25.0, (2, n)))
    return Ping.of(rng.uniform(0.1, 3.0, n), *angles, reflectance=rng.choice([0.1, 0.9], n), time=np.zeros(n))


def test_it_is_a_model_by_name_and_determined_by_the_seed():
    model, ping = load_model("rig"), conditions(50)
    assert isinstance(model, SonarModel)
    first, again = (simulate(model, ping, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first.range, again.range)
    assert len(np.unique(first.range)) > 20
    steps = first.range / model.resolution
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)


def test_batches_agree_with_single_visits_of_the_rig():
    """Medians and detection rates of 16 conditions, with 60 pings each, in one batch and as separate visits."""
    ping = conditions(16, 4)
    model = RigModel(Rig(Unit.nominal(), replace(SIMULATED, gain=20, output="us", drift_c=0.0)))
    many = ping[np.tile(np.arange(16), 60)]
    batch = model.law(many).sample(np.random.default_rng(0)).range.reshape(60, 16)
    for k in range(16):
        visit = Ping.of(ping.distance[k], ping.angle[k], ping.incidence[k], ping.reflectance[k], 2.4 * np.arange(60))
        alone = model.rig.ping(visit, np.random.default_rng(k)).reading(model.rig.setup).range
        detected = [value > 0 for value in (batch[:, k], alone)]
        assert detected[0].mean() == pytest.approx(detected[1].mean(), abs=0.3)
        if min(mask.mean() for mask in detected) > 0.5:
            centres = [np.median(value[value > 0]) for value in (batch[:, k], alone)]
            assert centres[0] == pytest.approx(centres[1], abs=0.006)


def test_sonars_of_one_car_do_not_interfere():
    """Identical conditions a hundredth of a second apart in one run: no false echoes."""
    ping = Ping.of(np.full(200, 2.0), reflectance=0.9, time=0.01 * np.arange(200))
    reading = load_model("rig").law(ping).sample(np.random.default_rng(0))
    assert np.abs(reading.range[reading.echo] - 2.0).max() < 0.08


def test_an_empty_cone_gives_no_echo_and_a_disconnected_sensor_no_answer():
    empty = Ping.of(np.full(50, 20.0), time=0.0)
    assert (load_model("rig").law(empty).sample(np.random.default_rng(0)).status != EchoStatus.NO_ANSWER).all()
    dead = RigModel(Rig(Unit.nominal(), Setup(bus=Bus(nack=1.0))))
    assert (dead.law(empty).sample(np.random.default_rng(0)).status == EchoStatus.NO_ANSWER).all()


def test_probabilities_raise():
    law = load_model("rig").law(conditions(3))
    assert not law.has_probabilities
    for query in (law.credence, lambda: law.no_answer, lambda: law.log_prob(law.sample(np.random.default_rng(0)))):
        with pytest.raises(SampleOnlyError, match=r"draw readings with `sample\(rng\)`"):
            query()
    assert issubclass(SampleOnlyError, NotImplementedError)
    assert issubclass(SampleOnlyError, SonarError)


def test_credence_given_a_reading_is_estimated_from_draws():
    """Exact reflectors have credence 1; tilted ones, whose post is read, less."""
    ping = Ping.of(np.repeat([1.0, 2.0], 200), reflectance=0.9, time=0.0)
    table = CredenceTable.over(RigModel(), ping, np.linspace(0.0, 3.0, 31))
    assert table.values[[10, 20]] == pytest.approx([1.0, 1.0])
    assert table.share.sum() == pytest.approx(1.0, abs=0.02)
    wrong = Ping.of(np.full(50, 2.0), np.deg2rad(25.0), np.deg2rad(60.0), 0.9, time=0.0)
    assert CredenceTable.over(RigModel(), wrong, np.linspace(0.0, 3.0, 4)).values.max() < 1.0
