"""`sonar-gym evaluate-agent` and `ship-agent`: episodes, intervals, files, cards."""

import json
import shutil
from dataclasses import replace

import gymnasium
import pytest

from acquisition import SettingError
from noise import GaussianModel, IdealModel
from sonar_gym.agent import WEIGHTS, AgentDriver, load_policy
from sonar_gym.control.driver import ParkingDriver, run_episode
from training.agents.evaluate import Args, Rate, evaluate, pool_of
from training.agents.ship import command
from training.agents.sonars import MismatchedLaw, MismatchedModel, mismatched
from training.cli import main


@pytest.mark.parametrize("name", ["parking", "scripted"])
def test_many_cars_at_once_end_as_each_alone(name):
    policy = load_policy(name) if name == "parking" else name
    driver = AgentDriver(policy) if name == "parking" else ParkingDriver()
    seeds = [3, 11, 4, 12]
    outcomes = evaluate(pool_of(policy), {"sonar": "gaussian", "odometry": "wheels"}, seeds)
    env = gymnasium.make("SonarParking-v0", sonar="gaussian", odometry="wheels")
    for k, seed in enumerate(seeds):
        alone = run_episode(env, driver, seed)
        assert (alone.success, alone.collision) == (outcomes.success[k], outcomes.collision[k])
        assert alone.steps == outcomes.steps[k]
        assert alone.score == pytest.approx(outcomes.score[k], abs=1e-4)


def test_a_pooled_rig_is_sampled_once_for_all_cars(monkeypatch):
    sizes = []
    sample = MismatchedLaw.sample
    monkeypatch.setattr(MismatchedLaw, "sample", lambda law, rng: (sizes.append(len(law)), sample(law, rng))[1])
    sonar = MismatchedModel(IdealModel(), GaussianModel())
    for pooled in (True, False):
        sizes.clear()
        outcomes = evaluate(pool_of("scripted"), {"sonar": sonar, "threads": 1}, [0, 1, 2], pooled=pooled)
        steps = outcomes.steps + 1  # and the pings of the reset
        assert len(sizes) == (steps.max() if pooled else steps.sum())


def test_intervals_are_wilson_s():
    # Newcombe (1998), table I: 81 of 263 and 0 of 20, method 3
    assert Rate(81, 263).interval == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert Rate(0, 20).interval == pytest.approx((0.0, 0.1611), abs=5e-5)


def test_agents_of_two_trainings_have_two_names(tmp_path, capsys):
    for run in ("first", "second"):
        shutil.copytree(WEIGHTS / "parking", tmp_path / run / "agent")
    agents = [str(tmp_path / run / "agent") for run in ("first", "second")]
    main(["evaluate-agent", "--agent", *agents, "--sonars", "ideal", "--episodes", "1"])
    printed = capsys.readouterr().out
    assert "first" in printed
    assert "second" in printed


def test_the_command_compares_and_films(tmp_path, capsys):
    out, film = tmp_path / "scores.json", tmp_path / "film.gif"
    args = ["--agent", "scripted", "parking", "--sonars", "ideal", "--episodes", "3", "--seed", "7"]
    main(["evaluate-agent", *args, "--out", str(out), "--film", str(film)])
    records = json.loads(out.read_text())
    assert [(one["agent"], one["episodes"]) for one in records] == [("scripted", 3), ("parking", 3)]
    assert records[0]["success"] == 1.0
    main(["evaluate-agent", *args, "--sonars", "rig", "--believed", "ideal", "--episodes", "1", "--out", str(out)])
    assert [(one["sonar"], one["believed"]) for one in json.loads(out.read_text())] == 2 * [("rig", "ideal")]
    assert film.read_bytes()[:6] in (b"GIF87a", b"GIF89a")
    assert "scripted" in capsys.readouterr().out


def test_invalid_settings_are_refused(tmp_path, capsys):
    with pytest.raises(SettingError, match=r"must end with \.gif"):
        Args(film=tmp_path / "film.mp4")
    with pytest.raises(SystemExit) as stop:
        main(["evaluate-agent", "--agent", "nobody", "--episodes", "1"])
    assert stop.value.code == 2
    assert "agent 'nobody': no such name or folder" in capsys.readouterr().err


def after_ppo(policy, steps):
    """Return an agent with one more leg in its history."""
    imitation = policy.about["history"][0]
    history = [imitation, {**imitation, "leg": 1, "steps": steps}]
    return replace(policy, about={**policy.about, "steps": steps, "planned": steps, "history": history})


def test_an_agent_is_saved_with_its_scores_and_commands(tmp_path, capsys):
    kinds = ["--sonars", "ideal", "rig", "--odometry", "exact", "--difficulty", "easy", "normal", "--episodes", "2"]
    policy = after_ppo(load_policy("parking"), steps=768)
    policy.save(tmp_path / "agent")
    main(["ship-agent", str(tmp_path / "agent"), "--out", str(tmp_path / "small"), *kinds])
    shipped = load_policy(tmp_path / "small")
    assert shipped.layers[0][0].tolist() == policy.layers[0][0].tolist()
    assert "sonar-gym train-agent --out run --sonars ideal" in shipped.card
    assert "--seed 0 --steps 768" in shipped.card
    assert shipped.card.count("| ideal | exact |") == shipped.card.count("| rig | exact |") == 2
    assert "then PPO for 768 steps of 0.1 s." in " ".join(shipped.card.split())
    assert shipped.card.count("| leg 1 | 768 | 98.0 % |") == 1
    assert max(map(len, shipped.card.split("    sonar-gym")[0].splitlines())) <= 120
    assert "small: saved" in capsys.readouterr().out


def test_the_card_s_command_has_all_settings():
    settings = {"sonars": ["ideal", "a b"], "faults": False, "num_envs": 8}
    line = command(settings, 768, "run")
    assert line == "sonar-gym train-agent --out run --sonars ideal 'a b' --no-faults --num-envs 8 --steps 768"


@pytest.mark.slow
def test_the_shipped_agent_parks_with_a_sonar_that_it_was_not_trained_with():
    """The rig is independent of the laws of training."""
    sonar = mismatched("rig", "srf08-mlp")
    outcomes = evaluate(pool_of(load_policy("parking")), {"sonar": sonar, "threads": 1}, range(100, 124), pooled=True)
    assert outcomes.success.mean() >= 0.85
    assert outcomes.collision.mean() <= 0.1
