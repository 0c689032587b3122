"""Mismatched and shifted sonars, and a small transfer experiment: table, figure, continuation."""

import numpy as np
import pandas as pd
import pytest

from acquisition import Ping, SettingError
from acquisition.limits import check_settings
from noise import GaussianModel, IdealModel
from noise.rig import RigModel
from sonar_gym.parking.vector import SonarParkingVectorEnv
from training.agents import transfer
from training.agents.sonars import MismatchedModel, ShiftedModel

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
    envs = [SonarParkingVectorEnv(2, sonar=sonar, threads=1) for sonar in sonars]
    tables = [env.fleet.sonar.tables for env in envs]
    assert np.array_equal(*tables)
    for env in envs:
        env.close()


def example_results():
    rng, rows = np.random.default_rng(0), []
    for world in transfer.WORLDS:
        for k, arm in enumerate(transfer.ARMS):
            for seed in range(2):
                success = rng.random(20) < 0.3 + 0.15 * k
                ends = {"success": success, "collision": ~success, "steps": 100}
                rows.append(pd.DataFrame({"world": world, "arm": arm, "seed": seed, "street": range(20), **ends}))
    return pd.concat(rows, ignore_index=True)


def test_table_and_figure_show_all_arms_in_all_worlds():
    results = example_results()
    lines = transfer.table(results).splitlines()
    assert len(lines) == 2 + len(transfer.ARMS) * len(transfer.WORLDS)
    one = results[(results.world == "rig") & (results.arm == "corrected")]
    assert f"{100 * one.success.mean():.1f} %" in lines[6]
    assert transfer.figure(results)[:8] == b"\x89PNG\r\n\x1a\n"


def test_invalid_settings_are_refused():
    with pytest.raises(SettingError, match=r"Args\.seeds: expected a whole number from 1 to 1000, got 0"):
        check_settings(transfer.Args(seeds=0))


@pytest.mark.slow
def test_an_experiment_is_continued_without_repeating_files(tmp_path):
    args = transfer.Args(tmp_path / "transfer", seeds=1, episodes=2, lessons=3, num_envs=4, workers=1)
    first = transfer.run(args)
    assert len(first) == 2 * len(transfer.ARMS) * len(transfer.WORLDS)
    times = {path: path.stat().st_mtime for path in args.out.rglob("*.csv")}
    assert transfer.run(args).equals(first)
    assert times == {path: path.stat().st_mtime for path in args.out.rglob("*.csv")}
