"""Saving, loading and driving agents, and the shipped agent."""

import json
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from acquisition import ModelError, UnknownModelError
from sonar_gym.agent import AgentDriver, Policy, VectorAgent, agent_names, load_agent, load_policy
from sonar_gym.control.driver import run_episode
from sonar_gym.control.memory import MemorySettings, ObservationMemory
from sonar_gym.parking.vector import SonarParkingVectorEnv


def policy(seed=0, repeat=2, **memory):
    settings = MemorySettings(**memory)
    rng, sizes = np.random.default_rng(seed), [ObservationMemory(1, settings=settings).size, 16, 2]
    layers = [
        (rng.normal(size=(b, a)).astype(np.float32) / np.float32(np.sqrt(a)), rng.normal(size=b).astype(np.float32))
        for a, b in pairwise(sizes)
    ]
    return Policy(layers, settings, repeat, {"seed": seed}, "# card\n")


def test_a_saved_agent_loads_unchanged(tmp_path):
    first = policy(lags=2)
    again = Policy.load(first.save(tmp_path / "agent"))
    features = np.random.default_rng(1).normal(size=(5, first.sizes[0])).astype(np.float32)
    assert np.array_equal(first.act(features), again.act(features))
    assert (again.memory, again.repeat, again.about, again.card) == (first.memory, 2, {"seed": 0}, "# card\n")
    assert sorted(path.name for path in (tmp_path / "agent").iterdir()) == [
        "README.md",
        "agent.json",
        "weights.safetensors",
    ]


def test_a_policy_is_a_perceptron_with_tanh():
    one = policy()
    features = np.random.default_rng(1).normal(size=(3, one.sizes[0])).astype(np.float32)
    (w1, b1), (w2, b2) = one.layers
    expected = [np.clip(w2 @ np.tanh(w1 @ row + b1) + b2, -1.0, 1.0) for row in features.astype(np.float64)]
    assert one.act(features) == pytest.approx(np.array(expected), abs=1e-5)


def test_saving_replaces_an_agent_and_nothing_else(tmp_path):
    policy(0).save(tmp_path / "agent")
    policy(1).save(tmp_path / "agent")
    assert Policy.load(tmp_path / "agent").about == {"seed": 1}
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("keep")
    with pytest.raises(ModelError, match="exists and is not an agent"):
        policy().save(tmp_path / "notes")
    assert (tmp_path / "notes" / "mine.txt").read_text() == "keep"


def damaged(folder, kind):
    text, tensors = folder / "agent.json", folder / "weights.safetensors"
    description = json.loads(text.read_text())
    if kind == "no description":
        text.unlink()
    elif kind == "no json":
        text.write_text("{")
    elif kind == "other version":
        text.write_text(json.dumps({**description, "format": 99}))
    elif kind == "other memory":
        text.write_text(json.dumps({**description, "memory": {"lags": 3}}))
    elif kind == "unknown field":
        text.write_text(json.dumps({**description, "memory": {"depth": 3}}))
    elif kind == "endless record":
        about = {"history": [{"success": 1.0}, {"success": np.inf}]}
        text.write_text(json.dumps({**description, "about": about}))
    elif kind == "no weights":
        tensors.unlink()
    elif kind == "cut weights":
        tensors.write_bytes(tensors.read_bytes()[:-8])
    elif kind == "not finite":
        save_file({name: np.full_like(value, np.nan) for name, value in load_file(tensors).items()}, tensors)
    elif kind == "other size":
        save_file({"x": np.zeros(1, dtype=np.float32)}, tensors)
    else:
        save_file({f"x{name}": value for name, value in load_file(tensors).items()}, tensors)


KINDS = {
    "no description": "contains no agent.json",
    "no json": "damaged",
    "other version": "format: input should be 1, got 99",
    "other memory": "memory.behind: field required",
    "unknown field": "memory",
    "endless record": "about.history.1.success: not a finite number",
    "no weights": "is missing",
    "cut weights": "damaged or of another model",
    "not finite": "not finite",
    "other size": "damaged or of another model",
    "other tensors": "the tensors differ",
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_agent_raises(tmp_path, kind):
    folder = policy().save(tmp_path / "agent")
    damaged(folder, kind)
    with pytest.raises(ModelError, match=KINDS[kind]):
        Policy.load(folder)


def test_an_unknown_name_raises_and_known_names_are_listed():
    with pytest.raises(UnknownModelError, match=r"agent 'nobody': no such name or folder; known names: .*parking"):
        load_agent("nobody")


def test_layers_that_do_not_fit_the_features_raise():
    one = policy()
    with pytest.raises(ModelError, match="do not map"):
        Policy(one.layers[:1], one.memory)


def test_actions_of_many_cars_equal_those_of_each_alone():
    """Also if their episodes begin at different times."""
    n, one = 4, policy(repeat=2)
    envs, agents, alone = SonarParkingVectorEnv(n, threads=1), VectorAgent(one, n), [AgentDriver(one) for _ in range(n)]
    seen, _ = envs.reset(seed=0)
    agents.reset(np.arange(n))
    for step in range(30):
        rows = np.arange(n) if step % 3 else np.array([0, 2])
        if step == 10:
            agents.reset(np.array([1]))
            alone[1].reset()
        together = agents.act({name: value[rows] for name, value in seen.items()}, rows)
        for k, row in enumerate(rows):
            action = alone[row].act({name: value[row] for name, value in seen.items()})
            assert together[k] == pytest.approx(action, abs=1e-6)
        seen, *_ = envs.step(np.tile([0.0, 0.4], (n, 1)))
    envs.close()


def test_an_action_is_repeated():
    one, env = policy(repeat=3), gymnasium.make("SonarParking-v0")
    driver, actions = AgentDriver(one), []
    driver.reset()
    seen, _ = env.reset(seed=0)
    for _ in range(12):
        actions.append(driver.act(seen).copy())
        seen, *_ = env.step(np.array([0.1, 0.5], dtype=np.float32))
    groups = np.array(actions).reshape(4, 3, 2)
    assert np.all(groups == groups[:, :1])
    assert len(np.unique(groups[:, 0], axis=0)) == 4


def test_the_shipped_agent_is_small_and_has_a_card():
    assert "parking" in agent_names()
    shipped = load_policy("parking")
    assert "## Training data" in shipped.card
    assert "## Scores" in shipped.card
    assert sum(weight.size + bias.size for weight, bias in shipped.layers) < 200_000


@pytest.mark.parametrize("sonar", ["ideal", "srf08-mlp"])
def test_the_shipped_agent_parks(sonar):
    env, driver = gymnasium.make("SonarParking-v0", sonar=sonar), load_agent("parking")
    episodes = [run_episode(env, driver, seed) for seed in range(20)]
    assert np.mean([episode.success for episode in episodes]) >= 0.9
    assert np.mean([episode.collision for episode in episodes]) <= 0.05
