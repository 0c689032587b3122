"""The law that stands for a simulation: it must hold what a simulated room does by itself."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from acquisition import Ping, Recording
from noise.discrepancy.baseline.emulate import Baseline, checked, emulated
from noise.discrepancy.baseline.emulator import in_company
from noise.discrepancy.common.rules import SURE_OF_AIR, Rules
from noise.discrepancy.common.splits import Split
from noise.discrepancy.judge.verdict import BaselineCheck
from noise.effects import CATALOGUE
from noise.fitting.batch import Batch
from noise.fitting.fit import log_likelihood
from noise.fitting.stack import VISITS, Stack
from noise.fitting.starts import nuisance_start
from noise.model import simulate
from noise.physical import PhysicalModel

torch.set_num_threads(1)
TARGET = {
    "travel_time_jitter": {"sigma_m": 0.003},
    "sensitivity": {"loss_db": 46.0},
    "beam_width": {"ka": 4.0},
    "specular_loss": {"strength": 0.4},
}
AIRY = ["spike", "scintillation"]
WALL = {"fixed_clutter": {"presence": 1.0, "range_m": 4.4, "spread_m": 0.005}}


def heard(seed, step=0.01, cells=70, pings=12, **effects):
    """Return readings of targets on a coarse register, a third of which are too far off the axis to be heard."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(np.round(rng.uniform(0.3, 3.6, cells), 3), pings)
    angle = np.repeat(np.round(rng.uniform(-0.5, 0.5, cells), 3), pings)
    placed = distance + np.repeat(rng.normal(0, 0.003, cells), pings)
    time = np.arange(len(distance)) * 0.1
    model = PhysicalModel([CATALOGUE[name](**values) for name, values in {**TARGET, **effects}.items()], step)
    reading = simulate(model, Ping.of(distance=placed, angle=angle, time=time), rng)
    return Recording.of(Ping.of(distance=distance, angle=angle, time=time), reading)


def bare(batch):
    return nuisance_start(Stack.of(PhysicalModel((), batch.resolution)), batch)


@pytest.mark.slow
def test_a_wall_that_answers_where_the_target_is_too_faint_is_part_of_the_simulation():
    recording, fresh = heard(3, **WALL), Batch.of(heard(13, **WALL))
    assert 0.1 < np.mean(fresh.is_outlier(fresh.error)) < 0.6, "the wall answers for a good part of the targets"
    truth = PhysicalModel([CATALOGUE[name](**values) for name, values in {**TARGET, **WALL}.items()], 0.01)
    best = Stack.of(truth).put([(VISITS, "placement_m"), (VISITS, "urn_weight")], [0.003, 0.0])
    stack = emulated(recording, None, 0).stack
    assert stack.get(("fixed_clutter", "range_m")) == pytest.approx(4.4, abs=0.02)
    assert log_likelihood(stack, fresh).mean() > log_likelihood(best, fresh).mean() - 0.4, "on positions it never met"


@pytest.mark.parametrize(
    ("off_m", "hangs", "good", "wholly"),
    [(0.0, 0.0, True, True), (0.0, 1.0, True, False), (0.02, 0.0, False, False)],
    ids=["right", "readings of one position hang together", "2 cm off"],
)
def test_a_law_describes_a_simulation_that_it_reads_right_whatever_its_air_does(off_m, hangs, good, wholly):
    rng = np.random.default_rng(4)
    distance, waits = np.repeat(rng.uniform(0.3, 3.0, 60), 12), np.tile(np.arange(12), 60)
    swell = hangs * 0.02 * np.sin(waits / 2.0 + np.repeat(rng.uniform(0, 2 * np.pi, 60), 12))
    law = PhysicalModel([CATALOGUE["travel_time_jitter"](sigma_m=0.004)])
    reading = simulate(law, Ping.of(distance=distance + swell + off_m), rng)
    scatter = float(np.hypot(0.004, swell.std()))
    stack = Stack.of(law).put([("travel_time_jitter", "sigma_m"), (VISITS, "placement_m")], [scatter, 0.0])
    check = checked(stack, Batch.of(Recording.of(Ping.of(distance=distance), reading)), np.random.default_rng(0))
    assert (check.describes_simulation, check.wholly) == (good, wholly)
    assert ("but for how" in check.note) == (good and not wholly)


def test_where_nothing_stands_out_nothing_else_is_tried():
    batch = Batch.of(heard(1))
    assert in_company(bare(batch), batch) == []


@pytest.mark.parametrize(("nats", "kept"), [(0.5 * SURE_OF_AIR, ["spike"]), (1.5 * SURE_OF_AIR, AIRY)])
def test_livelier_air_beside_an_effect_must_gain_more_than_another_day_changes(monkeypatch, nats, kept):
    monkeypatch.setattr(Baseline, "_repaired", lambda *_: False)
    recording = heard(1)
    base = emulated_by_itself(recording)
    crossed = SimpleNamespace(first=SimpleNamespace(stack=base.stack), nats=np.zeros(8))
    gains = {"spike": np.full(8, 20.0), "scintillation": np.full(8, nats / 8)}
    search = SimpleNamespace(
        seed=0,
        rules=Rules(),
        never=(),
        attempts=[],
        contribution=lambda chosen, cross, name: (gains[name], crossed),
        cross=lambda *_, **__: crossed,
    )
    assert base.without_repairs(search, AIRY, crossed, crossed)[0] == kept
    assert all("another day's air" in attempt.decision for attempt in search.attempts)


def emulated_by_itself(recording):
    split = Split.of(Batch.of(recording), np.random.default_rng(0))
    return Baseline(bare(split.both), PhysicalModel(()), BaselineCheck(True, 1.0, ""), split)


def cone(robot, seed, n=1200, half_rad=0.25):
    """Return the log of a robot whose simulated sonar takes the nearest point of a wall within a cone, as rays do."""
    rng = np.random.default_rng(seed)
    there, angle = robot.way(rng, n), robot.turning(rng, n)
    nearest = there * np.cos(angle) / np.cos(np.maximum(np.abs(angle) - half_rad, 0.0))
    return robot.log_of(nearest + rng.normal(0.0, 0.005, n), distance=there, angle=angle)


def test_cones_of_rays_are_held_to_millimetres(robot):
    stack, fresh = emulated(cone(robot, 1), None, 0).stack, Batch.of(cone(robot, 2))
    error = fresh.reading.range - stack.expected(fresh)
    assert np.abs(fresh.error).mean() > 0.03, "the nearest point is not where the axis meets the wall"
    assert np.median(np.abs(error)) < 0.005
    assert np.sqrt(np.mean(error**2)) < 0.009


def test_no_threshold_is_held_where_nothing_is_missed(robot):
    assert "sensitivity" not in emulated(cone(robot, 3), None, 0).stack.values
