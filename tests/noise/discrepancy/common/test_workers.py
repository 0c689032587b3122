"""Fits that are shared out among processes: the same as alone, in their order, and told when a process is lost."""

import os

import numpy as np
import pytest
import torch

from acquisition import Ping, Recording, SettingError
from noise import IdealModel, PhysicalModel
from noise.discrepancy import diagnose
from noise.discrepancy.common.workers import MOST, Workers, usable
from noise.effects import CATALOGUE
from noise.model import simulate


def recording(n=240):
    rng = np.random.default_rng(0)
    ping = Ping.of(distance=np.repeat(rng.uniform(0.3, 2.5, n // 8), 8), time=np.arange(n, dtype=float))
    effects = [CATALOGUE["zero_offset"](offset_m=0.03), CATALOGUE["travel_time_jitter"](sigma_m=0.002)]
    return Recording.of(ping, simulate(PhysicalModel(effects), ping, rng), name="moved")


def test_the_verdict_is_the_same_with_any_number_of_processes():
    told = [diagnose(IdealModel(), recording(), workers=count).to_verdict() for count in (1, 2)]
    assert told[0] == told[1]
    assert [named["effect"] for named in told[0]["effects"]] == ["zero_offset"]


def test_items_come_back_in_order_from_processes_of_one_thread():
    workers, here = Workers(2), os.getpid()
    workers.start()
    found = workers.map(lambda k: (k, os.getpid() != here, torch.get_num_threads()), range(5))
    assert found == [(k, True, 1) for k in range(5)]
    assert Workers(1).map(lambda k: os.getpid(), range(2)) == [here, here]


def test_a_lost_process_is_told():
    with pytest.raises(SettingError, match="one of 2 worker processes was killed"):
        Workers(2).map(lambda k: os._exit(1), range(2))
    assert Workers(2).map(abs, [-1, -2]) == [1, 2]


def test_a_job_that_fails_fails_as_alone():
    for workers in (Workers(1), Workers(2)):
        with pytest.raises(ZeroDivisionError):
            workers.map(lambda k: 1 // k, [1, 0])


def test_none_is_refused_and_few_are_usual():
    with pytest.raises(SettingError, match="1 or more, got 0"):
        Workers(0)
    assert 1 <= usable() <= MOST
