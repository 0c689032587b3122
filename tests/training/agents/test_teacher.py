"""The worlds in which agents learn, the teacher in them, and what is learned from it."""

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from acquisition import SettingError
from sonar_gym.control.memory import Memory, MemorySettings
from sonar_gym.parking.vector import SonarParkingVectorEnv
from training.agents.imitation import Comments, Lessons, imitate, mean_action
from training.agents.teacher import Teacher
from training.agents.worlds import AgentVecEnv


def worlds(n, *kinds, repeat=2):
    envs = AgentVecEnv(n, kinds or ({"sonar": "ideal"},), MemorySettings(), repeat)
    envs.seed(1)
    return envs


def ends_of_teacher(envs, decisions=160):
    teachers = [Teacher(venv.envs.fleet) for venv in envs.venvs]
    envs.reset()
    for _ in range(decisions):
        ways = [envs.memory.way[part] for part in envs.parts]
        envs.advance(np.concatenate([t.act(way) for t, way in zip(teachers, ways, strict=True)]))
    return np.array([(end.success, end.collision) for end in envs.ended])


@pytest.mark.parametrize("difficulty", ["normal", "hard"])
def test_the_teacher_parks(difficulty):
    ended = ends_of_teacher(worlds(100, {"sonar": "ideal", "difficulty": difficulty}))
    assert len(ended) >= 95
    assert ended[:, 0].mean() >= 0.98
    assert ended[:, 1].mean() <= 0.02


def test_the_teacher_does_not_hear_the_sonars():
    """It knows the truth, so what a sonar says changes nothing of what it does, but for the ways that noise counts."""
    ideal, noisy = (ends_of_teacher(worlds(20, {"sonar": sonar}), 100) for sonar in ("ideal", "gaussian"))
    assert np.array_equal(ideal, noisy)


def test_cars_of_several_worlds_are_each_in_their_own():
    envs = worlds(4, {"sonar": "ideal"}, {"sonar": "gaussian"})
    shown = envs.reset()
    alone = worlds(4, {"sonar": "ideal"}, {"sonar": "ideal"}).reset()
    assert np.array_equal(shown[:2], alone[:2])
    assert not np.array_equal(shown[2:], alone[2:])
    assert envs.observation_space.contains(shown[0])


def test_a_decision_holds_for_so_many_steps_and_is_paid_for_all():
    envs, plain, memory = worlds(3, repeat=3), SonarParkingVectorEnv(3), Memory(3)
    everyone, action = np.arange(3), np.tile(np.float32([0.1, 0.7]), (3, 1))
    first = envs.reset()
    seen, _ = plain.reset(seed=1)
    memory.forget(everyone)
    memory.see(everyone, seen)
    assert np.array_equal(first, memory.show(everyone))
    shown, reward, _, _ = envs.advance(action)
    paid = np.zeros(3)
    for _ in range(3):
        seen, r, *_ = plain.step(action)
        memory.see(everyone, seen)
        paid += r
    assert np.array_equal(shown, memory.show(everyone))
    assert reward == pytest.approx(paid, abs=1e-5)
    plain.close()


def test_an_episode_that_ends_is_told_whole_and_forgotten():
    envs = worlds(2)
    envs.reset()
    forwards, total = np.tile(np.float32([-1.0, 1.0]), (2, 1)), np.zeros(2)
    for _ in range(60):  # into the boxes on the right
        shown, reward, done, infos = envs.advance(forwards)
        total += reward
        if done[0]:
            break
    assert done[0]
    assert infos[0]["collision"]
    assert infos[0]["episode"]["r"] == pytest.approx(total[0], abs=1e-4)
    assert envs.ended[0].collision
    assert infos[0]["terminal_observation"].shape == shown[0].shape
    assert envs.memory.way[0] == pytest.approx(0.0, abs=1e-6)  # of the new episode, in which nothing has happened
    assert not np.array_equal(infos[0]["terminal_observation"], shown[0])


def test_too_few_cars_are_refused():
    with pytest.raises(SettingError, match="num_envs must be >= 2"):
        AgentVecEnv(1, ({}, {}), MemorySettings())


def test_comments_keep_the_last():
    comments = Comments(4, 2, 1)
    for k in range(3):
        comments.add(np.full((2, 2), k, dtype=np.float32), np.full((2, 1), k))
    shown, action = comments.draw(200, np.random.default_rng(0))
    assert set(shown[:, 0].tolist()) == {1.0, 2.0}  # the first two have made room
    assert torch.equal(shown[:, :1], action)


def test_an_imitator_comes_to_do_what_the_teacher_does():
    envs = worlds(32, {"sonar": "ideal", "difficulty": "easy"})
    with torch.random.fork_rng():
        torch.manual_seed(0)
        policy = PPO("MlpPolicy", envs, policy_kwargs={"net_arch": [64]}, device="cpu").policy
        losses = []
        lessons = Lessons(rounds=120, guided=1.0, kept=8000, batch=256)
        imitate(policy, envs, lessons, np.random.default_rng(0), lambda done, loss: losses.append(loss))
    assert np.mean(losses[-20:]) < 0.4 * np.mean(losses[:5])
    assert len(losses) == 120
    own = mean_action(policy, torch.from_numpy(envs.reset())).detach().numpy()
    advice = Teacher(envs.venvs[0].envs.fleet).act(envs.memory.way)
    assert np.abs(own[:, 1] - advice[:, 1]).mean() < 0.2  # all begin by driving on
