"""`sonar-gym train-agent` and `evaluate-agent`: killed and gone on with, paired and counted."""

import json

import gymnasium
import numpy as np
import pytest
from safetensors.numpy import load_file

from acquisition import ModelError, Ping, SettingError
from noise import IdealModel
from sonar_gym.agent import AgentDriver, load_policy
from sonar_gym.control.driver import ParkingDriver, run_episode
from training.agents import evaluate_agent, train
from training.agents.evaluate import Rate, crew_of, evaluate
from training.agents.learning_curve import course, learning_curve
from training.agents.real import heard_as
from training.agents.train import Args, Training, Trials
from training.cli import main
from training.common.checkpoint import read_state

SMALL = {"sonars": ("ideal",), "faults": False, "num_envs": 8, "hidden": (16,), "lessons": 20, "steps": 3 * 256}
SHORT = Trials(length=8, updates=2, batch=64, epochs=2, watching=1)


class Killed(Exception):
    pass


def run(out, kill_after=99, **change):
    training = Training(Args(out, **{**SMALL, **change}), trials=SHORT)
    save, training.resumed = training._save, training.resume()

    def save_or_die():
        save()
        if training.leg > kill_after:
            raise Killed

    training._save = save_or_die
    training.run()
    training.envs.close()
    return training


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("agents") / "whole"
    return out, run(out)


def test_a_killed_training_comes_to_the_same_agent(tmp_path, whole):
    for after in (1, 2):
        with pytest.raises(Killed):
            run(tmp_path / "cut", kill_after=after)
    training = run(tmp_path / "cut")
    assert training.resumed
    first, again = (load_file(out / "checkpoint.safetensors") for out in (whole[0], tmp_path / "cut"))
    assert first.keys() == again.keys()
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert [one["steps"] for one in training.history] == [0, 256, 512, 768]


def test_the_learning_curve_lies_beside_the_agent(whole):
    out, training = whole
    assert (out / "learning.png").read_bytes() == learning_curve(training.history)
    assert (out / "learning.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert [one["steps"] for one in training.history[0]["course"]] == [2 * k * 8 * 2 for k in range(1, 10)]


def test_the_learning_curve_begins_with_imitation():
    ended = {"episodes": 9, "success": 0.5, "collision": 0.1, "seconds_an_episode": 12.0}
    tenths = [{"steps": 200_000 * k, **ended} for k in range(1, 10)]
    history = [{"steps": 0, "course": tenths, **ended}, {"steps": 500_000, **ended}]
    taught, points = course(history)
    assert taught == pytest.approx(2.0)
    assert [at for at, _ in points] == pytest.approx([*np.arange(0.2, 2.1, 0.2), 2.5])
    assert course([{"steps": 500_000, **ended}])[0] == 0.0
    silent = [{**one, "episodes": 0, "success": 0.0} for one in history]
    assert len({learning_curve(one) for one in (history, history[:1], silent)}) == 3


def test_a_sonar_is_also_learned_with_as_it_errs():
    kinds = Args("x", sonars=("ideal", "gaussian"), odometry=("exact", "worn")).worlds
    assert [kind["odometry"] for kind in kinds] == 4 * ["exact", "worn"]
    law, bad = (model.law(Ping.of(distance=np.ones(2000))) for model in (IdealModel(), kinds[4]["sonar"]))
    readings = [one.sample(np.random.default_rng(0)).range for one in (law, bad)]
    assert np.mean(np.abs(readings[0] - 1.0) < 0.01) == 1.0
    assert np.mean(np.abs(readings[1] - 1.0) < 0.01) == pytest.approx(0.85 + 0.1 * 0.16, abs=0.02)
    with pytest.raises(SettingError, match="3 cars for 4 kinds of world"):
        Args("x", sonars=("ideal", "gaussian"), num_envs=3)


def test_another_seed_comes_to_another_agent(tmp_path, whole):
    other = run(tmp_path / "other", seed=1)
    assert not np.array_equal(other.policy().layers[0][0], whole[1].policy().layers[0][0])


def test_what_is_saved_acts_as_what_was_trained(whole):
    out, training = whole
    shown = np.random.default_rng(0).normal(size=(6, training.envs.memory.size)).astype(np.float32)
    expected, _ = training.model.predict(shown, deterministic=True)
    assert load_policy(out / "agent").act(shown) == pytest.approx(expected, abs=1e-5)


def test_imitation_is_left_alone_while_values_are_learned(whole, tmp_path):
    taught = run(tmp_path / "taught", steps=0).policy().layers
    watched = run(tmp_path / "watched", steps=256).policy().layers
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(taught, watched, strict=True))
    moved = whole[1].policy().layers
    assert not np.array_equal(taught[0][0], moved[0][0])


def test_other_settings_are_not_mixed_into_a_training(whole):
    with pytest.raises(SettingError, match=r"was begun with seed = 0, not 5: go on with the same settings"):
        Training(Args(whole[0], **SMALL, seed=5), trials=SHORT).resume()


def test_a_damaged_checkpoint_is_told(tmp_path, whole):
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes((whole[0] / "checkpoint.safetensors").read_bytes()[:1000])
    with pytest.raises(ModelError, match="cannot be read as a checkpoint"):
        read_state(path)


def test_course_of_training_is_on_the_board(whole):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    board = EventAccumulator(str(whole[0] / "tensorboard"))
    board.Reload()
    assert [event.step for event in board.Scalars("episodes/success")] == [0, 256, 512, 768]
    assert {"train/loss", "train/approx_kl"} <= set(board.Tags()["scalars"])


@pytest.mark.parametrize("wrong", [{"lessons": 0, "steps": 0}, {"num_envs": 1, "sonars": ("ideal", "gaussian")}])
def test_a_training_of_nothing_is_refused(tmp_path, wrong):
    with pytest.raises(SettingError):
        Args(tmp_path, **wrong)


@pytest.mark.slow
def test_an_agent_learns_to_park_from_nothing_in_minutes(tmp_path):
    train.train(Args(tmp_path / "agent", sonars=("ideal",), hidden=(128, 64), num_envs=128, lessons=600, steps=0))
    outcomes = evaluate(crew_of(load_policy(tmp_path / "agent" / "agent")), {"sonar": "ideal"}, range(200))
    assert outcomes.successes.share >= 0.9


# ---- evaluation ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("who", ["agent", "scripted"])
def test_many_at_once_end_as_each_alone(whole, who):
    policy = load_policy(whole[0] / "agent") if who == "agent" else who
    driver = AgentDriver(policy) if who == "agent" else ParkingDriver()
    seeds = [3, 11, 4, 12]
    outcomes = evaluate(crew_of(policy), {"sonar": "gaussian", "odometry": "wheels"}, seeds)
    env = gymnasium.make("SonarParking-v0", sonar="gaussian", odometry="wheels")
    for k, seed in enumerate(seeds):
        alone = run_episode(env, driver, seed)
        assert (alone.success, alone.collision) == (outcomes.success[k], outcomes.collision[k])
        assert alone.steps == outcomes.steps[k]
        assert alone.score == pytest.approx(outcomes.score[k], abs=1e-4)


def test_intervals_are_wilson_s():
    # Newcombe (1998), table I: 81 of 263 and 0 of 20, method 3
    assert Rate(81, 263).interval == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert Rate(0, 20).interval == pytest.approx((0.0, 0.1611), abs=5e-5)


def test_command_compares_and_films(tmp_path, whole, capsys):
    out, film = tmp_path / "scores.json", tmp_path / "film.gif"
    args = ["--agent", "scripted", str(whole[0] / "agent"), "--sonars", "ideal", "--episodes", "3", "--seed", "7"]
    main(["evaluate-agent", *args, "--out", str(out), "--film", str(film)])
    said = json.loads(out.read_text())
    assert [(one["agent"], one["episodes"]) for one in said] == [("scripted", 3), (str(whole[0] / "agent"), 3)]
    assert said[0]["success"] == 1.0
    main(["evaluate-agent", *args, "--sonars", "rig", "--believed", "ideal", "--episodes", "1", "--out", str(out)])
    assert [(one["sonar"], one["believed"]) for one in json.loads(out.read_text())] == 2 * [("rig", "ideal")]
    assert film.read_bytes()[:6] in (b"GIF87a", b"GIF89a")
    assert "scripted" in capsys.readouterr().out


def test_what_cannot_be_evaluated_is_refused(tmp_path, capsys):
    with pytest.raises(SettingError, match=r"must end with \.gif"):
        evaluate_agent.Args(film=tmp_path / "film.mp4")
    with pytest.raises(SystemExit) as stop:
        main(["evaluate-agent", "--agent", "nobody", "--episodes", "1"])
    assert stop.value.code == 2
    assert "agent 'nobody': no such name or folder" in capsys.readouterr().err


def test_an_agent_is_written_out_with_its_course_and_scores(tmp_path, whole, capsys):
    kinds = ["--sonars", "ideal", "rig", "--odometry", "exact", "--difficulty", "easy", "normal", "--episodes", "2"]
    main(["ship-agent", str(whole[0] / "agent"), "--out", str(tmp_path / "small"), *kinds])
    shipped = load_policy(tmp_path / "small")
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(shipped.layers, whole[1].policy().layers, strict=True))
    assert "sonar-gym train-agent --out run --sonars ideal" in shipped.card
    assert "--seed 0 --steps 768" in shipped.card
    assert shipped.card.count("| ideal | exact |") == shipped.card.count("| rig | exact |") == 2
    assert "learned by trial for 768 steps of 0.1 s (PPO)" in " ".join(shipped.card.split())
    assert max(map(len, shipped.card.split("    sonar-gym")[0].splitlines())) <= 127
    assert "It has met no sonar but those above" in shipped.card
    assert "small: saved" in capsys.readouterr().out


def test_the_shipped_agent_parks_with_a_sonar_that_it_has_never_heard():
    """The rig shares nothing with the laws that it was trained with; an agent of PPO parked in a tenth of these."""
    crew, sonar = crew_of(load_policy("parking")), heard_as("rig", "srf08-mlp")
    outcomes = evaluate(crew, {"sonar": sonar, "threads": 1}, range(100, 124), pooled=True)
    assert outcomes.success.mean() >= 0.85
    assert outcomes.collision.mean() <= 0.1
