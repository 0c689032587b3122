"""Mismatched and shifted sonars, and a small transfer experiment: table, figure, continuation."""

import json
from itertools import product

import numpy as np
import pandas as pd
import pytest

from acquisition import Ping, Recording, SettingError
from acquisition.limits import check_settings
from noise import GaussianModel, IdealModel, load_model
from noise.rig import RigModel
from sonar_gym.parking.vector import SonarParkingVectorEnv
from training.agents import transfer
from training.agents.sonars import MismatchedModel, ShiftedModel

LEARNERS = ("ppo", "imitation")
PING = Ping.of(distance=[0.3, 1.0, 2.0, 2.5], reflectance=0.9)


def test_readings_follow_the_actual_law_and_credence_the_assumed_one():
    model = MismatchedModel(actual=IdealModel(), assumed=GaussianModel(sigma=0.3))
    law = model.law(PING)
    assert law.sample(np.random.default_rng(0)).range == pytest.approx(PING.distance, abs=1e-3)
    assert np.array_equal(law.credence(), GaussianModel(sigma=0.3).law(PING).credence())


def test_the_same_stream_gives_the_same_readings():
    law = MismatchedModel(RigModel(), IdealModel()).law(PING)
    first, again, other = (law.sample(np.random.default_rng(seed)).range for seed in (0, 0, 1))
    assert np.array_equal(first, again)
    assert first == pytest.approx(PING.distance, rel=0.1)
    assert other == pytest.approx(PING.distance, rel=0.1)


def test_the_moved_rig_reads_longer_by_the_offset():
    args = transfer.Args(moved_mm=80.0)
    rig, moved = (transfer.rig_of(world, args).law(PING).sample(np.random.default_rng(0)) for world in transfer.WORLDS)
    assert moved.range - rig.range == pytest.approx(np.full(4, 0.08), abs=0.012)


def test_a_shifted_law_reads_longer_and_counts_credence_from_the_origin():
    plain, moved = IdealModel(), ShiftedModel(IdealModel(), 0.05)
    law = moved.law(PING)
    assert law.sample(np.random.default_rng(0)).range == pytest.approx(PING.distance + 0.05, abs=1e-3)
    assert np.array_equal(law.distance, PING.distance)
    assert law.credence().tolist() == [0.0, 1.0, 1.0, 1.0]  # 50 mm exceed 10 % of 0.3 m
    assert plain.law(PING).credence().tolist() == [1.0] * 4


def test_the_environment_observes_credence_of_the_assumed_model():
    assumed = GaussianModel(sigma=0.1)
    sonars = (MismatchedModel(IdealModel(), assumed), assumed)
    envs = [SonarParkingVectorEnv(2, sonar=sonar, threads=1, credence_driver=None) for sonar in sonars]
    tables = [env.fleet.sonar.tables for env in envs]
    assert np.array_equal(*tables)
    for env in envs:
        env.close()


def test_a_shifted_model_keeps_what_persists():
    learned = load_model("srf08-mlp")
    assert ShiftedModel(learned, 0.05).persistence == learned.persistence
    assert ShiftedModel(IdealModel(), 0.05).persistence is None


def example_results():
    """Return episodes of four agents an arm: the k-th parks in k * 20 % of the streets, and always with "beam"."""
    rows = []
    for learner, world, arm, agent in product(LEARNERS, transfer.WORLDS, transfer.ARMS, range(4)):
        success = np.arange(20) < (20 if arm == "beam" else 4 * agent)
        about = {"learner": learner, "world": world, "arm": arm, "agent": agent, "street": range(20)}
        rows.append(pd.DataFrame({**about, "success": success}))
    return pd.concat(rows, ignore_index=True)


def test_tables_count_agents_and_the_figure_shows_all_worlds():
    results = example_results()
    tables = transfer.table(results).split("\n\n")
    titles = [f"{learner}, {world}:" for learner, world in product(LEARNERS, transfer.WORLDS.values())]
    assert tables[::2] == titles
    for one in tables[1::2]:
        rows = {line.split(" | ")[0].lstrip("| "): line for line in one.splitlines()}
        assert "| 4 | 30.0 % (" in rows["ideal"]  # the middle two of 0, 20, 40, 60 %
        assert "| 0, 20, 40, 60 |" in rows["ideal"]
        # of the 70 divisions of eight agents, two are as extreme
        assert "| 100.0 % (100.0 to 100.0) | 100, 100, 100, 100 | 100 % (100 to 100) | 0.029 |" in rows["beam"]
    assert transfer.figure(transfer.shares_of(results))[:8] == b"\x89PNG\r\n\x1a\n"


def test_agents_are_made_in_turn_so_that_what_is_finished_is_balanced():
    jobs = transfer.jobs_of(transfer.Args(seeds=3))
    assert len(set(jobs)) == len(jobs) == 3 * len(LEARNERS) * len(transfer.ARMS)
    assert [job.number for job in jobs] == sorted(job.number for job in jobs)
    assert transfer.Args(arms=("learned",)).all_arms == ("ideal", "learned")


def test_the_baselines_have_the_spread_of_the_survey():
    ping = Ping.of(distance=np.linspace(0.3, 2.5, 4000), reflectance=0.9)
    reading = GaussianModel(0.04, 0.0, 0.2).law(ping).sample(np.random.default_rng(0))
    fitted = transfer.baseline("gaussian", Recording.of(ping, reading, "survey"))
    assert fitted.sigma + 1.4 * fitted.sigma_per_metre == pytest.approx(0.04, rel=0.05)
    assert fitted.miss == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(("probability", "offset_m"), [(0.9, 0.05), (0.2, 0.0)])
def test_the_offset_is_that_of_a_believed_cause(tmp_path, probability, offset_m):
    size = {"offset_m": {"value": 50.0, "unit": "mm"}}
    cause = {"effect": "zero_offset", "probability": probability, "parameters": size}
    (tmp_path / "verdict.json").write_text(json.dumps({"causes": [cause]}))
    assert transfer.offset_found(tmp_path) == pytest.approx(offset_m)


def test_invalid_settings_are_refused():
    with pytest.raises(SettingError, match=r"Args\.seeds: expected a whole number from 2 to 1000, got 1"):
        check_settings(transfer.Args(seeds=1))


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_an_experiment_is_continued_without_repeating_files(tmp_path, monkeypatch):
    monkeypatch.setattr(transfer, "SENSORS", 1)
    args = transfer.Args(tmp_path / "transfer", seeds=2, episodes=2, lessons=3, steps=64, num_envs=4, workers=1)
    first = transfer.run(args)
    assert len(first) == 2 * len(transfer.jobs_of(args)) * len(transfer.WORLDS)
    times = {path: path.stat().st_mtime for path in args.out.rglob("*.csv")}
    assert transfer.run(args).equals(first)
    assert times == {path: path.stat().st_mtime for path in args.out.rglob("*.csv")}
