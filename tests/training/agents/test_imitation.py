"""The agents' vector environment, the teacher, and imitation."""

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from acquisition import SettingError
from sonar_gym.control.memory import MemorySettings, ObservationMemory
from sonar_gym.parking.vector import SonarParkingVectorEnv
from training.agents.imitation import ImitationSettings, LabelBuffer, Teacher, imitate, mean_action
from training.agents.vec_env import AgentVecEnv


def make_envs(n, *kinds, repeat=2):
    envs = AgentVecEnv(n, kinds or ({"sonar": "ideal"},), MemorySettings(), repeat)
    envs.seed(1)
    return envs


def results_of_teacher(envs, decisions=160):
    teachers = [Teacher(venv.envs.fleet) for venv in envs.venvs]
    envs.reset()
    for _ in range(decisions):
        ways = [envs.memory.travel[part] for part in envs.parts]
        envs.advance(np.concatenate([t.act(way) for t, way in zip(teachers, ways, strict=True)]))
    return np.array([(end.success, end.collision) for end in envs.ended])


@pytest.mark.parametrize("difficulty", ["normal", "hard"])
def test_the_teacher_parks(difficulty):
    ended = results_of_teacher(make_envs(100, {"sonar": "ideal", "difficulty": difficulty}))
    assert len(ended) >= 95
    assert ended[:, 0].mean() >= 0.98
    assert ended[:, 1].mean() <= 0.02


def test_the_teacher_does_not_depend_on_readings():
    ideal, noisy = (results_of_teacher(make_envs(20, {"sonar": sonar}), 100) for sonar in ("ideal", "gaussian"))
    assert np.array_equal(ideal, noisy)


def test_each_car_drives_in_its_own_kind_of_environment():
    envs = make_envs(4, {"sonar": "ideal"}, {"sonar": "gaussian"})
    shown = envs.reset()
    ideal = make_envs(4, {"sonar": "ideal"}, {"sonar": "ideal"}).reset()
    assert np.array_equal(shown[:2], ideal[:2])
    assert not np.array_equal(shown[2:], ideal[2:])
    assert envs.observation_space.contains(shown[0])


def test_an_action_is_repeated_and_its_rewards_are_summed():
    envs, plain, memory = make_envs(3, repeat=3), SonarParkingVectorEnv(3), ObservationMemory(3)
    rows, action = np.arange(3), np.tile(np.float32([0.1, 0.7]), (3, 1))
    first = envs.reset()
    observation, _ = plain.reset(seed=1)
    memory.reset(rows)
    memory.update(rows, observation)
    assert np.array_equal(first, memory.features(rows))
    shown, reward, _, _ = envs.advance(action)
    total = np.zeros(3)
    for _ in range(3):
        observation, r, *_ = plain.step(action)
        memory.update(rows, observation)
        total += r
    assert np.array_equal(shown, memory.features(rows))
    assert reward == pytest.approx(total, abs=1e-5)
    plain.close()


def test_the_end_of_an_episode_is_reported_and_clears_the_memory():
    envs = make_envs(2)
    envs.reset()
    action, total = np.tile(np.float32([-1.0, 1.0]), (2, 1)), np.zeros(2)
    for _ in range(60):  # into the boxes on the right
        shown, reward, done, infos = envs.advance(action)
        total += reward
        if done[0]:
            break
    assert done[0]
    assert infos[0]["collision"]
    assert infos[0]["episode"]["r"] == pytest.approx(total[0], abs=1e-4)
    assert envs.ended[0].collision
    assert infos[0]["terminal_observation"].shape == shown[0].shape
    assert envs.memory.travel[0] == pytest.approx(0.0, abs=1e-6)  # of the new episode
    assert not np.array_equal(infos[0]["terminal_observation"], shown[0])


def test_too_few_cars_are_refused():
    with pytest.raises(SettingError, match="num_envs must be >= 2, one for each kind of environment, got 1"):
        AgentVecEnv(1, ({}, {}), MemorySettings())


def test_new_labels_replace_the_oldest():
    buffer = LabelBuffer(4, 2, 1)
    for k in range(3):
        buffer.add(np.full((2, 2), k, dtype=np.float32), np.full((2, 1), k))
    shown, action = buffer.draw(200, np.random.default_rng(0))
    assert set(shown[:, 0].tolist()) == {1.0, 2.0}
    assert torch.equal(shown[:, :1], action)


def test_imitation_approaches_the_teacher():
    street = {"start": (0.0, 0.0)}  # all begin with the lane, which is learned in these few rounds
    envs = make_envs(32, {"sonar": "ideal", "difficulty": "easy", "street": street})
    with torch.random.fork_rng():
        torch.manual_seed(0)
        policy = PPO("MlpPolicy", envs, policy_kwargs={"net_arch": [64]}, device="cpu").policy
        losses = []
        settings = ImitationSettings(rounds=120, teacher_share=1.0, buffer_size=8000, batch_size=256)
        imitate(policy, envs, settings, np.random.default_rng(0), lambda done, loss: losses.append(loss))
    assert np.mean(losses[-20:]) < 0.4 * np.mean(losses[:5])
    assert len(losses) == 120
    own = mean_action(policy, torch.from_numpy(envs.reset())).detach().numpy()
    labels = Teacher(envs.venvs[0].envs.fleet).act(envs.memory.travel)
    assert np.abs(own[:, 1] - labels[:, 1]).mean() < 0.2  # all begin by driving forwards
