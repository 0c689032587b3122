"""`sonar-gym dataset`: Minari reads what was written, and the environment repeats it; a clone of the driver."""

import runpy
from pathlib import Path

import minari
import numpy as np
import pytest

from sonar_gym.agent import load_policy
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


def test_a_clone_of_the_driver_is_an_agent(folder, tmp_path, capsys):
    example = runpy.run_path(str(ROOT / "examples" / "behaviour_cloning.py"))
    share = example["main"](str(folder / NAME), str(tmp_path / "clone"), passes=2, streets=2)
    outcomes = evaluate(pool_of(load_policy(tmp_path / "clone")), {"threads": 1}, [1_000_000, 1_000_001])
    assert outcomes.success.mean() == share
    assert f"parked in {share:.1%} of 2 unseen streets" in capsys.readouterr().out
