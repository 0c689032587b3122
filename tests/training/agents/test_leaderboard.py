"""`sonar-gym leaderboard`: damage of the sonars, drivers, rows that cannot be changed, and the published table."""

import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import VecMonitor

from acquisition import EchoStatus, ModelError, Ping
from acquisition.errors import SampleOnlyError
from noise import IdealModel, load_model
from sonar_gym.agent import WEIGHTS
from sonar_gym.parking.vector import SonarParkingVectorEnv
from sonar_gym.sb3 import SonarExtractor, SonarVecEnv
from training.agents.drivers import ModelPool, load_zip, pool_by_name
from training.agents.evaluate import ScriptedPool
from training.agents.leaderboard import tracks
from training.agents.leaderboard.rows import read_row, read_rows, table
from training.agents.leaderboard.tracks import TRACKS, OneDisplaced, Track, board_checksum
from training.agents.sonars import LooseContact
from training.cli import main
from training.common.checksum import canonical, sha256

ROOT = Path(__file__).parents[3]
SHORT = {"hard": Track("normal", 3, sonar="ideal"), "manoeuvre": Track("easy", 2, sonar="ideal")}


@pytest.fixture
def short(monkeypatch):
    """Tracks of a few streets with the ideal sonar under the damage."""
    monkeypatch.setattr(tracks, "TRACKS", SHORT)
    monkeypatch.setattr("training.agents.leaderboard.rows.TRACKS", SHORT)


# ---- the damage ------------------------------------------------------------------------------------------------------


def test_a_loose_contact_changes_one_sonar_of_each_car():
    number, rng = np.arange(12), np.random.default_rng(0)
    law = LooseContact(IdealModel(), 0.3, sonars=4).law(Ping.of(distance=np.full(12, 1.0), run=number))
    readings = [law.sample(rng) for _ in range(50)]
    wrong = np.any([np.abs(reading.range - 1.0) > 0.01 for reading in readings], axis=0)
    assert number[wrong].tolist() == [0, 5, 10]
    assert all(np.all(reading.status == EchoStatus.ECHO) for reading in readings)


def test_the_share_of_arbitrary_readings_is_the_given_one():
    model, rng = LooseContact(IdealModel(), 0.3, 1), np.random.default_rng(0)
    ping = Ping.of(distance=[1.0], run=[0])
    ranges = np.array([model.law(ping).sample(rng).range[0] for _ in range(2000)])
    arbitrary = ranges[np.abs(ranges - 1.0) > 0.01]
    assert len(arbitrary) / len(ranges) == pytest.approx(0.3, abs=0.04)  # four standard errors
    assert arbitrary.mean() == pytest.approx(0.5 * model.law(ping).max_range, rel=0.1)


def test_all_paths_of_a_ping_have_the_same_arbitrary_reading():
    ping = Ping.of(distance=[0.5, 1.0, 1.5], run=[0, 0, 0])
    reading = LooseContact(IdealModel(), 1.0, 1).law(ping).sample(np.random.default_rng(0))
    assert len(set(reading.range)) == 1


def test_a_loose_contact_has_no_probabilities():
    with pytest.raises(SampleOnlyError, match="draw readings"):
        LooseContact(IdealModel(), 0.5, 1).law(Ping.of(distance=[1.0])).credence()


def test_one_sonar_of_each_car_is_displaced():
    envs = SonarParkingVectorEnv(40, randomize=OneDisplaced(along=0.03, turn_deg=20.0), threads=1)
    envs.reset(seed=0)
    nominal = SonarParkingVectorEnv(1, threads=1).fleet.worlds.mounts
    moved = np.abs(envs.fleet.worlds.mounts - nominal)
    assert np.array_equal((moved > 0).any(axis=2).sum(axis=1), np.ones(40))
    assert len(set(moved.any(axis=2).argmax(axis=1))) == 8
    assert np.all(moved.max(axis=(0, 1)) <= [0.03, 0.03, np.radians(20.0)])


# ---- drivers ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kwargs", [{}, {"features_extractor_class": SonarExtractor, "net_arch": [32]}])
def test_a_model_in_a_file_drives_as_it_did_before(tmp_path, kwargs):
    envs = VecMonitor(SonarVecEnv(4, threads=1))
    settings = {"n_steps": 16, "batch_size": 64, "seed": 1, "policy_kwargs": kwargs}
    model = PPO("MultiInputPolicy", envs, device="cpu", **settings).learn(64)
    model.save(tmp_path / "model.zip")
    observation = envs.reset()
    pool = pool_by_name(str(tmp_path / "model.zip"), "ppo")(4)
    assert np.array_equal(pool.act(observation, np.arange(4)), model.predict(observation, deterministic=True)[0])
    with pytest.raises(ModelError, match="its networks are not those of sac"):
        load_zip(tmp_path / "model.zip", "sac")


def test_pickled_settings_of_a_file_are_not_read(tmp_path):
    class Unpickled(Exception):
        pass

    class Bomb:
        def __reduce__(self):
            return Unpickled, ()

    kwargs = {"net_arch": [8], "optimizer_kwargs": {"eps": 1e-5}}
    model = SAC("MultiInputPolicy", SonarVecEnv(1, threads=1), buffer_size=10, policy_kwargs=kwargs, device="cpu")
    model.bomb = Bomb()
    model.save(tmp_path / "plain.zip")
    load_zip(tmp_path / "plain.zip", "sac")
    model.policy_kwargs["bomb"] = Bomb()
    model.save(tmp_path / "pickled.zip")
    with pytest.raises(ModelError, match="policy_kwargs are pickled"):
        load_zip(tmp_path / "pickled.zip", "sac")


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        (0.5, "is no model of Stable-Baselines3"),
        (None, "is no model of Stable-Baselines3"),
        ({"nosuch": 1}, "its policy_kwargs are not those of ppo"),
        ({"net_arch": "x"}, "its policy_kwargs are not those of ppo"),
        ({"net_arch": [10**6, 10**6]}, "name a width of 1000000, expected at most 4096"),
    ],
)
def test_a_damaged_model_in_a_file_is_named(tmp_path, kwargs, message):
    model = PPO("MultiInputPolicy", SonarVecEnv(1, threads=1), n_steps=16, batch_size=16, device="cpu")
    model.save(tmp_path / "whole.zip")
    with zipfile.ZipFile(tmp_path / "whole.zip") as whole, zipfile.ZipFile(tmp_path / "bad.zip", "w") as bad:
        bad.writestr("data", json.dumps({**json.loads(whole.read("data")), "policy_kwargs": kwargs}))
        bad.writestr("policy.pth", whole.read("policy.pth"))
    with pytest.raises(ModelError, match=message):
        load_zip(tmp_path / "bad.zip", "ppo")


class Counter:
    """A recurrent model whose action is the number of observations since its episode began."""

    def predict(self, observation, state, begins, deterministic):
        n = len(begins)
        (before,) = (np.zeros((1, n, 1)),) if state is None else state
        after = np.where(begins[None, :, None], 0.0, before) + 1.0
        return np.repeat(after[0], 2, axis=1), (after,)


def test_a_recurrent_model_has_a_state_for_each_car():
    pool = ModelPool(Counter(), 3)
    pool.reset(np.arange(3))
    assert pool.act({}, np.arange(3))[:, 0].tolist() == [1, 1, 1]
    assert pool.act({}, np.array([0, 2]))[:, 0].tolist() == [2, 2]
    pool.reset(np.array([2]))
    assert pool.act({}, np.arange(3))[:, 0].tolist() == [3, 2, 1]


# ---- rows ------------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("short")
def test_drivers_are_scored_and_the_table_is_verified(tmp_path, capsys):
    main(["leaderboard", "scripted", "--out", str(tmp_path)])
    main(["leaderboard", "training.agents.evaluate:ScriptedPool", "--name", "again", "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    rows = read_rows(tmp_path)
    assert [row["name"] for row in rows] == ["again", "scripted"]
    assert rows[0]["results"] == rows[1]["results"]  # the same driver on the same streets
    assert printed.endswith(table(rows) + "\n")
    main(["leaderboard", "--out", str(tmp_path)])
    assert capsys.readouterr().out == table(rows) + "\n"


@pytest.mark.usefixtures("short")
def test_a_row_is_replaced_by_that_of_the_same_driver_alone(tmp_path, capsys):
    words = ["--name", "mine", "--out", str(tmp_path)]
    main(["leaderboard", "scripted", *words])
    main(["leaderboard", "scripted", *words])
    before = (tmp_path / "mine.json").read_bytes()
    with pytest.raises(SystemExit) as stopped:
        main(["leaderboard", "training.agents.evaluate:ScriptedPool", *words])
    assert stopped.value.code == 2
    assert "mine.json: is the row of another driver" in capsys.readouterr().err
    assert (tmp_path / "mine.json").read_bytes() == before


@pytest.mark.usefixtures("short")
def test_agents_of_two_trainings_have_two_rows(tmp_path):
    for run in ("first", "second"):
        shutil.copytree(WEIGHTS / "parking", tmp_path / run / "agent")
        main(["leaderboard", str(tmp_path / run / "agent"), "--out", str(tmp_path / "rows")])
    assert {row["name"] for row in read_rows(tmp_path / "rows")} == {"first", "second"}


@pytest.mark.usefixtures("short")
def test_a_changed_row_is_found(tmp_path, capsys):
    main(["leaderboard", "scripted", "--out", str(tmp_path)])
    path = tmp_path / "scripted.json"
    row = json.loads(path.read_text())
    row["results"]["hard"]["parked"] = "111"
    row["results"]["hard"]["collided"] = "001"
    path.write_text(json.dumps(row))
    with pytest.raises(ModelError, match="was changed after it was written"):
        read_row(path, board_checksum())
    row["board_sha256"] = "0" * 64
    del row["checksum"]
    path.write_text(json.dumps({**row, "checksum": sha256(canonical(row))}))
    with pytest.raises(ModelError, match="other streets or settings"):
        read_row(path, board_checksum())


def test_the_checksum_depends_on_streets_damage_and_models(monkeypatch):
    def checksum(**changed):
        with monkeypatch.context() as patch:
            patch.setattr(tracks, "TRACKS", {"one": Track(**{"difficulty": "hard", "streets": 2, **changed})})
            return board_checksum()

    changes = [{}, {"streets": 3}, {"first_seed": 1}, {"loose": 0.1}, {"displaced": OneDisplaced(along=0.01)}]
    assert len({checksum(**one) for one in changes}) == len(changes)
    assert checksum() == checksum()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nobody"], "agent 'nobody': no such name or folder"),
        (["no.such:thing"], "driver 'no.such:thing': cannot be imported"),
        (["..:thing"], "driver '..:thing': cannot be imported"),
        (["training.agents.evaluate:FRAME_STEPS"], "is a int, expected a function of the number of cars"),
        (["builtins:list"], "driver 'builtins:list': fails for"),
        (["sys:exit"], "driver 'sys:exit': fails for"),
        (["builtins:str"], "driver 'builtins:str': makes a str, expected a pool with reset and act"),
        (["nosuch.zip"], "nosuch.zip: is no file of a model"),
        (["scripted", "--name", "../x"], "--name '../x': it becomes a file: use letters"),
        ([], "no rows; give a driver to score"),
    ],
)
def test_what_cannot_be_scored_is_one_line(words, message, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["leaderboard", *words, "--out", str(tmp_path / "rows")])
    assert stopped.value.code == 2
    assert message in capsys.readouterr().err


def test_the_published_table_is_that_of_the_rows():
    rows = read_rows(ROOT / "benchmarks" / "leaderboard")
    assert rows
    assert table(rows) in (ROOT / "docs" / "explanation" / "learning.md").read_text()


def test_the_tracks_are_those_of_the_rig():
    assert all(not load_model(track.sonar).law(Ping.of(distance=[1.0])).has_probabilities for track in TRACKS.values())


def test_a_pool_is_made_for_any_number_of_cars():
    assert isinstance(pool_by_name("training.agents.evaluate:ScriptedPool", "ppo")(2), ScriptedPool)
