"""What an agent observes, and the comparison by agents of `sonar-gym compare-observations`."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from sonar_gym.agent import load_policy
from sonar_gym.control.memory import MemorySettings, ObservationMemory
from training.agents import compare_observations, train
from training.agents.compare_observations import ARMS, Args, folder_of
from training.agents.leaderboard.tracks import Track
from training.cli import main
from training.common.statistics import AgentScores

ROW = np.zeros(1, dtype=np.int64)


def features(arm, **observed):
    """Return what a memory shows after an observation whose entries are given, and random otherwise."""
    rng, memory = np.random.default_rng(0), ObservationMemory(1, settings=MemorySettings(credence=arm[0], echo=arm[1]))
    memory.reset(ROW)
    observation = {"ranges": rng.random((1, 8)), "credence": rng.random((1, 8)), "echo": np.ones((1, 8))}
    memory.update(ROW, {**observation, "ego": np.zeros((1, 7)), **observed})
    return memory.features(ROW)[0]


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_an_agent_sees_what_its_arm_names_and_nothing_else(arm):
    silent = np.tile([0.0, 1.0], 4)[None]
    plain = features(arm)
    assert np.array_equal(plain, features(arm, credence=np.full((1, 8), 0.3))) != arm[0]
    assert np.array_equal(plain, features(arm, echo=silent)) != arm[1]
    assert not np.array_equal(plain, features(arm, ranges=np.full((1, 8), 0.2)))


def test_an_agent_keeps_its_arm_when_it_is_saved(tmp_path):
    settings = train.Args(tmp_path, sonars=("ideal",), faults=False, lessons=1, num_envs=4, hidden=(4,), echo=False)
    train.train(settings)
    assert load_policy(tmp_path / train.AGENT).memory == MemorySettings(echo=False)
    assert load_policy("parking").memory == MemorySettings()


def test_the_experiment_continues_and_compares(tmp_path, monkeypatch, capsys):
    arms = {name: ARMS[name] for name in (compare_observations.REFERENCE, "everything")}
    monkeypatch.setattr(compare_observations, "ARMS", arms)
    monkeypatch.setattr(compare_observations, "TRACKS", {"hard": Track("easy", 2, sonar="ideal")})
    words = ["--agents", "2", "--streets", "2", "--lessons", "1", "--num-envs", "4", "--workers", "1"]
    main(["compare-observations", "--out", str(tmp_path), *words])
    first = capsys.readouterr().out
    assert [line.split("|")[1].strip() for line in first.splitlines()[2:]] == list(arms)
    assert (tmp_path / "table.md").read_text() == first
    stored = folder_of(Args(tmp_path), "everything", 1) / "scores.csv"
    scores = pd.read_csv(stored)
    scores["success"] = True
    stored.write_text(scores.to_csv(index=False))
    main(["compare-observations", "--out", str(tmp_path), *words])  # makes nothing again
    assert "| 0, 100 |" in capsys.readouterr().out


# ---- statistics by agent ---------------------------------------------------------------------------------------------


def test_comparisons_by_agent_have_the_known_values():
    low, high = (AgentScores(np.array(scores)) for scores in ([0.1, 0.2, 0.3, 0.4, 0.5], [0.6, 0.7, 0.8, 0.9, 1.0]))
    rng = np.random.default_rng(0)
    assert high.exceeds(low, rng) == (1.0, (1.0, 1.0))
    assert high.exceeds(high, rng)[0] == 0.5
    assert high.p(low, rng) == pytest.approx(2 / 252)  # of all divisions of ten agents, two are as extreme
    assert low.centre == pytest.approx(0.3)


def test_the_interval_moves_with_the_scores_and_holds_its_level():
    scores = np.random.default_rng(1).normal(size=12)
    one, moved = (AgentScores(scores + shift).interval(np.random.default_rng(0)) for shift in (0.0, 5.0))
    assert np.subtract(moved, one) == pytest.approx([5.0, 5.0])
    wide = AgentScores(norm.ppf((np.arange(400) + 0.5) / 400)).interval(np.random.default_rng(0))
    # standard error of a 25 % trimmed mean of 400 normal scores: 1.092 / 20
    assert np.array(wide) == pytest.approx([-1.96 * 1.092 / 20, 1.96 * 1.092 / 20], rel=0.08)
    assert AgentScores(np.full(3, 0.5)).interval(np.random.default_rng(0)) == (0.5, 0.5)
