"""`sonar-gym dataset`: Minari reads what was written, and the environment repeats it; a clone of the driver."""

import runpy
import shutil
from pathlib import Path

import minari
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from minari.dataset.minari_dataset import parse_dataset_id

from sonar_gym.agent import WEIGHTS, load_policy
from sonar_gym.control.memory import ObservationMemory
from training.agents.dataset import dataset_id
from training.agents.evaluate import evaluate, pool_of
from training.cli import main

ROOT = Path(__file__).parents[3]
NAME = "sonar-parking/scripted-gaussian-v0"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("data")
    words = ["--drivers", "scripted", "--sonars", "gaussian", "--odometry", "wheels", "--episodes", "3", "--seed", "5"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(out.parent)
        main(["dataset", "--out", out.name, *words])  # a relative folder, as a user gives it
    return out


@pytest.fixture
def dataset(folder, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    return minari.load_dataset(NAME)


def episodes_of(folder):
    return minari.MinariDataset(folder / NAME / "data").iterate_episodes()


def test_minari_finds_the_dataset(dataset):
    assert dataset.total_episodes == 3
    assert [path.name for path in Path(dataset.spec.data_path).parents[1].iterdir()] == ["scripted-gaussian-v0"]
    assert "parked in 100.0 %" in dataset.storage.metadata["description"]


def test_the_environment_repeats_each_episode(dataset):
    env = dataset.recover_environment()
    for k, episode in enumerate(dataset.iterate_episodes()):
        seen, _ = env.reset(seed=5 + k)
        assert len(episode) > 50
        for t, action in enumerate(episode.actions):
            assert all(np.array_equal(seen[name], values[t]) for name, values in episode.observations.items())
            seen, reward, terminated, truncated, _ = env.step(action)
            assert reward == pytest.approx(episode.rewards[t])
            assert (terminated, truncated) == (episode.terminations[t], episode.truncations[t])
        assert all(np.array_equal(seen[name], values[-1]) for name, values in episode.observations.items())
        assert terminated or truncated
    env.close()


def test_a_dataset_is_not_written_over(folder, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["dataset", "--out", str(folder), "--drivers", "scripted", "--sonars", "gaussian"])
    assert stopped.value.code == 2
    assert f"{NAME} exists" in capsys.readouterr().err


def test_two_drivers_of_one_name_are_named_before_any_drives(tmp_path, capsys):
    folders = [tmp_path / place / "run" / "agent" for place in ("a", "b")]
    for folder in folders:
        shutil.copytree(WEIGHTS / "parking", folder)
    with pytest.raises(SystemExit) as stopped:
        main(["dataset", "--out", str(tmp_path / "out"), "--drivers", *map(str, folders), "--sonars", "ideal"])
    assert stopped.value.code == 2
    assert "sonar-parking/run-ideal-v0 would be written twice" in capsys.readouterr().err


@given(st.text("ab./:- é", min_size=1), st.text("ab.", min_size=1))
def test_minari_takes_the_name_of_every_dataset(driver, sonar):
    assert parse_dataset_id(dataset_id(driver, sonar))[0] == "sonar-parking"


@pytest.fixture(scope="module")
def offline():
    return runpy.run_path(str(ROOT / "examples" / "offline.py"))


@pytest.mark.parametrize("method", ["clone", "iql"])
def test_an_agent_learns_from_datasets_alone(offline, method, folder, tmp_path, capsys):
    settings = {"agent": str(tmp_path / method), "steps": 5, "streets": 2}
    rate = offline["main"](method, str(folder / NAME), str(folder / NAME), **settings)
    outcomes = evaluate(pool_of(load_policy(tmp_path / method)), {"threads": 1}, [1_000_000, 1_000_001])
    assert outcomes.successes == rate
    assert f"parked in {rate} of 2 unseen streets" in capsys.readouterr().out


def test_implicit_q_learning_weights_actions_by_their_advantage(offline):
    """The 0.8-expectile of rewards of 1 and -1, equally frequent, is 0.6: weights exp(3 * 0.4), exp(-3 * 1.6)."""
    torch.manual_seed(0)
    critic, action = offline["Critic"](1, 1), torch.tensor([[1.0], [-1.0]]).repeat(64, 1)
    state, ended = torch.ones(128, 1), torch.ones(128)
    some = offline["Decisions"](state, action, action[:, 0], state, ended)
    weights = [critic.weights(some) for _ in range(1500)][-1]
    assert critic.value(state)[0].item() == pytest.approx(0.6, abs=0.01)
    assert weights[:2].numpy() == pytest.approx(np.exp([3 * 0.4, -3 * 1.6]), rel=0.05)


def test_a_decision_is_followed_by_the_next_observation(offline, folder):
    memory = ObservationMemory(1)
    data = offline["read"]([str(folder / NAME)], memory)
    assert data.final.sum() == 3  # all parked
    assert data.reward.sum().item() == pytest.approx(sum(e.rewards.sum() for e in episodes_of(folder)), rel=1e-5)
    inside = torch.nonzero(data.final[:-1] == 0).squeeze(1)
    assert torch.equal(data.after[inside], data.shown[inside + 1])
