"""The parking task under RLlib, and sweeps on Ray Tune, with a Ray of two processors on this machine."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

pytest.importorskip("ray", reason="needs the extra `ray`: pip install 'sonar-gym[ray]'")

import ray

from acquisition import SettingError
from sonar_gym.agent import load_agent
from training.agents import rllib, sweep

pytestmark = pytest.mark.filterwarnings("ignore")  # Ray's own


@pytest.fixture(scope="module")
def two_workers():
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield
    ray.shutdown()


def test_the_environment_keeps_gymnasium_s_rules():
    check_env(rllib.environment({"sonar": "gaussian"}), skip_render_check=True)


def test_it_shows_what_an_agent_remembers():
    """An agent's own driver, and its policy over the wrapped environment, drive alike."""
    driver = load_agent("parking")
    policy = driver._agents.policy
    wrapped = rllib.environment({"sonar": "gaussian", "memory": policy.memory.to_dict(), "repeat": policy.repeat})
    plain = gymnasium.make("SonarParking-v0", sonar="gaussian")
    driver.reset()
    shown, _ = wrapped.reset(seed=4)
    seen, _ = plain.reset(seed=4)
    for _ in range(10):
        action = policy.act(shown[None])[0]
        shown, reward, *_ = wrapped.step(action)
        paid = 0.0
        for _ in range(policy.repeat):
            own = driver.act(seen)
            assert own == pytest.approx(action, abs=1e-6)
            seen, part, *_ = plain.step(own)
            paid += part
        assert reward == pytest.approx(paid, abs=1e-6)


@pytest.mark.slow
def test_rllib_trains_on_two_workers(two_workers):
    config = rllib.ppo(runners=2, envs_each=2).training(train_batch_size=400, minibatch_size=100, num_epochs=1)
    learner = config.build_algo()
    result = learner.train()
    learner.stop()
    assert result["env_runners"]["num_env_steps_sampled_lifetime"] >= 400
    assert np.isfinite(result["learners"]["default_policy"]["total_loss"])


SMALL = {"seeds": (0, 1), "sonars": ("ideal",), "lessons": 3, "steps": 1, "num_envs": 4}


@pytest.mark.slow
def test_a_sweep_is_gone_on_with_where_it_was(two_workers, tmp_path):
    found = sweep.run(sweep.Args(tmp_path / "sweep", **SMALL))
    assert found["seed"].tolist() == [0, 1]
    assert (found["steps"] > 0).all()
    folders = sorted(path.name for path in (tmp_path / "sweep" / "agents").iterdir())
    assert folders == ["seed=0-learning_rate=0.0001-sonar=ideal", "seed=1-learning_rate=0.0001-sonar=ideal"]
    times = [path.stat().st_mtime for path in (tmp_path / "sweep").glob("agents/*/checkpoint.safetensors")]
    again = sweep.run(sweep.Args(tmp_path / "sweep", **SMALL))
    assert again.equals(found)
    assert times == [path.stat().st_mtime for path in (tmp_path / "sweep").glob("agents/*/checkpoint.safetensors")]


def test_a_sweep_of_nothing_is_refused():
    with pytest.raises(SettingError, match="give a worker or more"):
        sweep.Args(workers=0)
