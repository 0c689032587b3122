"""Errors persist for a face, change with movement, and leave the law of every single ping as it is."""

import numpy as np
import pytest
from scipy.stats import kstest, norm, spearmanr

from acquisition import Ping
from noise import CATALOGUE, ComposedModel, Faulty, load_model
from noise.faults import Constant
from noise.learned.persistence import Persistence
from sonar_gym.parking.environment import SonarParkingEnv
from sonar_gym.sensing import paths
from sonar_gym.sensing.persistence import LATENTS, PersistentStream, latents

N = 4000
KEYS = np.arange(N) * 7919


def facing(distance=1.0, face=3, texture=0.0, x=0.0):
    path = np.zeros((N, paths.N_PATH))
    path[:, paths.DISTANCE], path[:, paths.FACE], path[:, paths.TEXTURE] = distance, face, texture
    path[:, paths.X] = x
    return path


def correlation(a, b):
    return np.corrcoef(a[0], b[0])[0, 1]


@pytest.mark.parametrize("lasting", [0.0, 0.85, 1.0])
def test_latent_numbers_are_standard_normal(lasting):
    for row in latents(facing(), KEYS, lasting, 0.03):
        assert kstest(row, norm.cdf).pvalue > 1e-3


def test_the_same_place_gives_the_same_number_and_movement_changes_it():
    here = latents(facing(), KEYS, 0.0, 0.03)
    assert np.array_equal(here, latents(facing(), KEYS, 0.0, 0.03))
    moved = [correlation(here, latents(facing(1.0 + step), KEYS, 0.0, 0.03)) for step in (0.002, 0.01, 0.03, 0.2)]
    assert moved == sorted(moved, reverse=True)
    assert moved[0] > 0.95
    assert abs(moved[-1]) < 0.1
    assert correlation(here, latents(facing(1.2), KEYS, 0.85, 0.03)) < 0.1 < 0.8
    lasting = latents(facing(), KEYS, 0.85, 0.03)
    assert correlation(lasting, latents(facing(1.2), KEYS, 0.85, 0.03)) == pytest.approx(0.85, abs=0.03)


def test_faces_episodes_and_the_two_numbers_are_independent():
    here = latents(facing(), KEYS, 0.85, 0.03)
    assert abs(correlation(here, latents(facing(face=4), KEYS, 0.85, 0.03))) < 0.06
    assert abs(correlation(here, latents(facing(), KEYS + 1, 0.85, 0.03))) < 0.06
    assert abs(np.corrcoef(here)[0, 1]) < 0.06


def test_movement_along_a_rough_face_changes_the_number_and_along_a_smooth_one_does_not():
    for texture, lowest, highest in ((0.0, 0.999, 1.0), (np.radians(10.0), -0.1, 0.3)):
        pair = [latents(facing(texture=texture, x=x), KEYS, 0.0, 0.03) for x in (0.0, 0.05)]
        assert lowest <= correlation(*pair) <= highest + 1e-9


class Uniform:
    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)

    def random(self, size):
        return self.rng.random(size)


def moved():
    """Return a learned sonar with an offset that a diagnosis found."""
    return ComposedModel(load_model("srf08-mlp"), [], [CATALOGUE["zero_offset"](offset_m=0.05)])


@pytest.mark.parametrize("model", [load_model("srf08-mlp"), moved()], ids=["learned", "composed"])
def test_the_law_of_a_single_ping_is_unchanged_and_identical_pings_agree(model):
    law = model.law(Ping.of(np.full(N, 2.5), np.radians(20.0), np.radians(20.0), 0.4))
    assert model.persistence == Faulty(model, []).persistence
    held = latents(facing(2.5), KEYS, model.persistence.lasting, model.persistence.length_m)
    first, second = (law.sample(PersistentStream(Uniform(k), held, model.persistence)) for k in (1, 2))
    alone = law.sample(np.random.default_rng(3))
    assert np.mean(first.echo) == pytest.approx(np.mean(alone.echo), abs=0.04)
    assert np.median(first.range[first.echo]) == pytest.approx(np.median(alone.range[alone.echo]), abs=0.02)
    agree = np.mean(first.echo == second.echo)
    independent = np.mean(alone.echo) ** 2 + (1 - np.mean(alone.echo)) ** 2
    assert 1.0 - agree < 0.35 * (1.0 - independent)
    assert Persistence(0.0, 0.0) != model.persistence
    assert held.shape == (LATENTS, N)


@pytest.mark.parametrize("made", [lambda base: base, lambda base: ComposedModel(base, [], [])], ids=["", "composed"])
def test_faults_do_not_persist_and_all_other_errors_do(made):
    rate, stuck_m, base = 0.25, 0.5, load_model("srf08-mlp")
    faulty, alike = made(Faulty(base, [Constant(rate, stuck_m)])), []
    for model in (faulty, made(base)):
        law = model.law(Ping.of(np.full(N, 1.5), reflectance=0.9))
        held = latents(facing(1.5), KEYS, model.persistence.lasting, model.persistence.length_m)
        both = [law.sample(PersistentStream(Uniform(k), held, model.persistence)) for k in (1, 2)]
        stuck = [np.abs(each.range - stuck_m) < 0.01 for each in both]
        heard = both[0].echo & both[1].echo & ~stuck[0] & ~stuck[1]
        alike.append(spearmanr(both[0].range[heard], both[1].range[heard]).statistic)
        share = rate if model is faulty else 0.0
        assert np.mean(stuck) == pytest.approx(share, abs=0.02)
        assert np.mean(stuck[0] & stuck[1]) == pytest.approx(share**2, abs=0.02)
    assert alike[0] == pytest.approx(alike[1], abs=0.1)
    assert min(alike) > 0.8
    assert faulty.causes == ("none", "CONSTANT")


def test_a_standing_car_gets_persistent_errors_in_the_environment():
    env, spread, between = SonarParkingEnv(sonar="srf08-mlp", crosstalk=False), [], []
    for seed in range(12):
        env.reset(seed=seed, options={"start": [0.3, 0.0, 0.0]})
        readings = np.array([env.step(np.zeros(2))[0]["ranges"][5] for _ in range(12)])
        spread.append(np.std(readings[readings < 1.0]))
        between.append(np.mean(readings[readings < 1.0]))
    assert np.mean(spread) < np.std(between)
