"""Concealed effects: hash of the description, reproducibility, and the change of readings."""

import hashlib

import numpy as np
import pytest

from acquisition import Ping
from acquisition.bench import Rig, Setup, Unit
from noise.effects import CATALOGUE
from training.diagnosis.envelope import CONCEALED, conceal


def test_the_seal_is_the_hash_of_the_file(tmp_path):
    _, envelope = conceal(Setup(), np.random.default_rng(1))
    envelope.save(tmp_path / "envelope.json")
    assert hashlib.sha256((tmp_path / "envelope.json").read_bytes()).hexdigest() == envelope.seal


def test_the_seed_determines_the_envelope():
    seals = [conceal(Setup(), np.random.default_rng(seed))[1].seal for seed in (1, 1, 2)]
    assert seals[0] == seals[1] != seals[2]


@pytest.mark.parametrize("effect", CONCEALED)
def test_a_concealed_effect_is_in_the_catalogue_and_changes_readings(effect):
    assert effect in CATALOGUE
    setup = Setup(gain=31)
    changed, envelope = conceal(setup, np.random.default_rng(3), effect)
    assert envelope.effect == effect
    ping = Ping.of(distance=np.full(60, 3.0), reflectance=0.9)
    before, after = (Rig(Unit.nominal(), s).record(ping, np.random.default_rng(0)).reading for s in (setup, changed))
    assert not np.array_equal(before.range, after.range)
