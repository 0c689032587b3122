"""`sonar-gym train-agent`: reproducible, and continued after an interruption."""

import numpy as np
import pytest
from safetensors.numpy import load_file

from acquisition import ModelError, Ping, SettingError
from noise import IdealModel
from sonar_gym.agent import load_policy
from training.agents import train
from training.agents.evaluate import evaluate, pool_of
from training.agents.train import Args, PPOSettings, Training, course, learning_curve
from training.common.checkpoint import read_state

SMALL = {"sonars": ("ideal",), "faults": False, "num_envs": 8, "hidden": (16,), "lessons": 20, "steps": 3 * 256}
SHORT = PPOSettings(rollout=8, updates=2, max_batch=64, epochs=2, value_legs=1)


class Killed(Exception):
    pass


def run(out, kill_after=99, **change):
    training = Training(Args(out, **{**SMALL, **change}), ppo=SHORT)
    training.resumed = training.resume()

    def die():
        if training.leg > kill_after:
            raise Killed

    training.run(die)
    training.envs.close()
    return training


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("agents") / "whole"
    return out, run(out)


def test_an_interrupted_training_gives_the_same_agent(tmp_path, whole):
    for after in (1, 2):
        with pytest.raises(Killed):
            run(tmp_path / "cut", kill_after=after)
    training = run(tmp_path / "cut")
    assert training.resumed
    first, again = (load_file(out / "checkpoint.safetensors") for out in (whole[0], tmp_path / "cut"))
    assert first.keys() == again.keys()
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert [one["steps"] for one in training.history] == [0, 256, 512, 768]


def test_the_learning_curve_is_saved_with_the_agent(whole):
    out, training = whole
    assert (out / "learning.png").read_bytes() == learning_curve(training.history)
    assert (out / "learning.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert [one["steps"] for one in training.history[0]["course"]] == [2 * k * 8 * 2 for k in range(1, 10)]


def test_the_learning_curve_begins_with_imitation():
    ended = {"episodes": 9, "success": 0.5, "collision": 0.1, "seconds_an_episode": 12.0}
    parts = [{"steps": 200_000 * k, **ended} for k in range(1, 10)]
    history = [{"steps": 0, "course": parts, **ended}, {"steps": 500_000, **ended}]
    imitated, points = course(history)
    assert imitated == pytest.approx(2.0)
    assert [at for at, _ in points] == pytest.approx([*np.arange(0.2, 2.1, 0.2), 2.5])
    assert course([{"steps": 500_000, **ended}])[0] == 0.0
    unfinished = [{**one, "episodes": 0, "success": 0.0} for one in history]
    assert len({learning_curve(one) for one in (history, history[:1], unfinished)}) == 3


def test_training_adds_each_sonar_with_faults():
    kinds = Args("x", sonars=("ideal", "gaussian"), odometry=("exact", "worn")).env_settings
    assert [kind["odometry"] for kind in kinds] == 4 * ["exact", "worn"]
    law, faulty = (model.law(Ping.of(distance=np.ones(2000))) for model in (IdealModel(), kinds[4]["sonar"]))
    readings = [one.sample(np.random.default_rng(0)).range for one in (law, faulty)]
    assert np.mean(np.abs(readings[0] - 1.0) < 0.01) == 1.0
    assert np.mean(np.abs(readings[1] - 1.0) < 0.01) == pytest.approx(0.85 + 0.1 * 0.16, abs=0.02)
    with pytest.raises(SettingError, match="--num-envs: expected at least 4, one for each kind of car, got 3"):
        Args("x", sonars=("ideal", "gaussian"), num_envs=3)


def test_another_seed_gives_another_agent(tmp_path, whole):
    other = run(tmp_path / "other", seed=1)
    assert not np.array_equal(other.policy().layers[0][0], whole[1].policy().layers[0][0])


def test_the_saved_agent_acts_as_the_trained_one(whole):
    out, training = whole
    shown = np.random.default_rng(0).normal(size=(6, training.envs.memory.size)).astype(np.float32)
    expected, _ = training.model.predict(shown, deterministic=True)
    assert load_policy(out / "agent").act(shown) == pytest.approx(expected, abs=1e-5)


def test_the_actor_is_frozen_while_values_are_learned(whole, tmp_path):
    imitated = run(tmp_path / "imitated", steps=0).policy().layers
    frozen = run(tmp_path / "frozen", steps=256).policy().layers
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(imitated, frozen, strict=True))
    assert not np.array_equal(imitated[0][0], whole[1].policy().layers[0][0])


def test_a_training_is_not_continued_with_other_settings(whole):
    with pytest.raises(SettingError, match=r"seed = 0, not 5"):
        Training(Args(whole[0], **SMALL, seed=5), ppo=SHORT).resume()


def test_a_damaged_checkpoint_is_refused(tmp_path, whole):
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes((whole[0] / "checkpoint.safetensors").read_bytes()[:1000])
    with pytest.raises(ModelError, match=r"checkpoint\.safetensors"):
        read_state(path)


def test_tensorboard_shows_the_course_of_training(whole):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    board = EventAccumulator(str(whole[0] / "tensorboard"))
    board.Reload()
    assert [event.step for event in board.Scalars("episodes/success")] == [0, 256, 512, 768]
    assert {"train/loss", "train/approx_kl"} <= set(board.Tags()["scalars"])


@pytest.mark.parametrize("wrong", [{"lessons": 0, "steps": 0}, {"num_envs": 1, "sonars": ("ideal", "gaussian")}])
def test_invalid_settings_are_refused(tmp_path, wrong):
    with pytest.raises(SettingError):
        Args(tmp_path, **wrong)


@pytest.mark.slow
def test_an_agent_learns_to_park_in_minutes(tmp_path):
    train.train(Args(tmp_path / "agent", sonars=("ideal",), hidden=(128, 64), num_envs=128, lessons=600, steps=0))
    outcomes = evaluate(pool_of(load_policy(tmp_path / "agent" / "agent")), {"sonar": "ideal"}, range(200))
    assert outcomes.successes.share >= 0.9
