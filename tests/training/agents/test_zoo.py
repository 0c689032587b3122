"""`sonar-gym zoo`: tuned settings, a short training of each row, and the files that it writes."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

import sonar_gym
from acquisition import SettingError
from noise.fitting.threads import one_thread
from sonar_gym.sb3 import SonarVecEnv
from sonar_gym.street.street import LEVELS
from training.agents.zoo.command import Args, Training, make_envs, parked
from training.agents.zoo.settings import tuned
from training.cli import main

ROWS = [
    *(("ppo", env_id) for env_id in sonar_gym.ENVIRONMENTS),
    *(("ppo_lstm", env_id) for env_id in ("SonarParking-v0", "SonarParkingManoeuvre-v0")),
    *((name, sonar_gym.GOAL_ENV_ID) for name in ("sac", "tqc")),
]


@pytest.mark.parametrize(("algorithm", "env_id"), ROWS)
def test_tuned_settings_make_a_model(algorithm, env_id):
    settings = tuned(algorithm, env_id)
    envs = make_envs(env_id, settings.n_envs, "ideal")
    model = settings.algorithm_class(env=envs, device="cpu", **settings.keywords)
    assert model.n_envs == settings.n_envs
    assert settings.n_timesteps >= 1e4
    assert all(callback.end == LEVELS["manoeuvre"] for callback in settings.make_callbacks())


def test_a_row_is_trained_tested_and_written(tmp_path, capsys):
    out = tmp_path / "row"
    main(["zoo", "ppo", "--out", str(out), "--steps", "8192", "--episodes", "5", "--seed", "3"])
    assert capsys.readouterr().out.startswith(f"{out}/model.zip: parked in ")
    assert sorted(path.name for path in out.iterdir()) == ["README.md", "model.zip", "result.json", "tensorboard"]
    result = json.loads((out / "result.json").read_text())
    assert (result["algorithm"], result["env"], result["seed"], result["steps"]) == ("ppo", "SonarParking-v0", 3, 8192)
    # the model in the file drives as the one that was tested
    assert parked(PPO.load(out / "model.zip", device="cpu"), Args("ppo", out, episodes=5)).count == result["parked"]
    assert (
        "sonar-gym zoo ppo --env SonarParking-v0 --sonar ideal --steps 8192 --seed 3" in (out / "README.md").read_text()
    )


class Stopped(Exception):
    """Ends a training between two legs, as the end of its process would."""


def stop():
    raise Stopped


OFF_POLICY = ("SonarParkingGoal-v0", {"learning_starts": 1600, "batch_size": 16, "buffer_size": 4000})


@pytest.mark.parametrize(
    ("algorithm", "env_id", "faster"),
    [
        ("ppo", "SonarParkingManoeuvre-v0", {"n_steps": 16, "batch_size": 256}),
        ("ppo_lstm", "SonarParking-v0", {"n_steps": 8, "batch_size": 256, "n_epochs": 1}),
        pytest.param("sac", *OFF_POLICY, marks=pytest.mark.slow),  # the buffer and the learner of the last one
        ("tqc", *OFF_POLICY),
    ],
)
@one_thread()
def test_an_interrupted_training_ends_with_the_same_model(tmp_path, algorithm, env_id, faster):
    settings = tuned(algorithm, env_id)
    settings = replace(settings, n_timesteps=8000, keywords={**settings.keywords, **faster})
    steps = 3000 if algorithm.startswith("ppo") else 2000  # hindsight needs an episode that has ended
    whole = Training(Args(algorithm, tmp_path / "whole", env=env_id, steps=steps, seed=3), settings)
    whole.run()
    assert whole.leg >= 2
    args = Args(algorithm, tmp_path / "stopped", env=env_id, steps=steps, seed=3)
    for leg in range(whole.leg):
        training = Training(args, settings)
        training.resume()
        assert training.leg == leg
        with pytest.raises(Stopped):
            training.run(stop)
    assert (training.leg, training.model.num_timesteps) == (whole.leg, whole.model.num_timesteps)
    weights = training.model.policy.state_dict()
    assert all(torch.equal(weights[name], value) for name, value in whole.model.policy.state_dict().items())


def test_an_interrupted_training_keeps_its_settings(tmp_path):
    args = Args("ppo", tmp_path, steps=10)
    settings = replace(tuned("ppo", args.env), n_timesteps=100, keywords={"policy": "MultiInputPolicy", "n_steps": 4})
    Training(args, settings).run()
    with pytest.raises(SettingError, match="was started with seed = 0, not 1"):
        Training(replace(args, seed=1), settings).resume()


def test_the_manoeuvre_begins_with_wide_gaps():
    (curriculum,) = tuned("ppo", "SonarParkingManoeuvre-v0").make_callbacks()
    assert curriculum.begin.gap == (0.85, 1.05)
    assert curriculum.begin.box == LEVELS["manoeuvre"].box


def test_the_test_drives_the_streets_from_seed_zero():
    envs = make_envs(sonar_gym.ENV_ID, 3, "ideal")
    envs.seed(0)
    envs.reset()
    assert envs.unwrapped.envs.np_random_seed == (0, 1, 2)


class Parker:
    """A model that puts the car of every second environment into its gap."""

    def __init__(self, monkeypatch):
        self.venv = None
        make = SonarVecEnv.__init__

        def noted(venv, *args, **settings):
            make(venv, *args, **settings)
            self.venv = venv

        monkeypatch.setattr(SonarVecEnv, "__init__", noted)

    def predict(self, observations, state=None, episode_start=None, deterministic=False):
        fleet = self.venv.envs.fleet
        for i in range(0, fleet.count, 2):
            street, car = fleet.world(i).street, fleet.car_settings
            place = 0.5 * sum(street.gap) - car.centre, 0.5 * (street.line + street.kerb)
            fleet.worlds.car[i] = (*place, 0.0, 0.0, 0.0)
        return np.zeros((fleet.count, 2), dtype=np.float32), state


def test_the_test_counts_each_street_once(monkeypatch, tmp_path):
    rate = parked(Parker(monkeypatch), Args("ppo", tmp_path, episodes=7))
    assert (rate.count, rate.trials) == (4, 7)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["trpo"], "algorithm 'trpo': no such algorithm; expected ppo, ppo_lstm, sac, tqc"),
        (
            ["sac", "--env", "SonarParking-v0"],
            "sac has no settings for 'SonarParking-v0'; expected SonarParkingGoal-v0",
        ),
        (["ppo", "--episodes", "0"], "--episodes: expected a whole number from 1 to 1000000, got 0"),
        (["ppo", "--seed", "-1"], "--seed: expected a whole number from 0 to 2147483647, got -1"),
    ],
)
def test_invalid_settings_are_one_line(args, message, tmp_path, capsys):
    with pytest.raises((SystemExit, SettingError)) as stopped:
        main(["zoo", *args, "--out", str(tmp_path)])
    assert stopped.value.code == 2
    assert message in " ".join(capsys.readouterr().err.split())
