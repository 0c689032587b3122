"""The parking task in RLlib, and sweeps on Ray Tune, on two local processors."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

pytest.importorskip("ray", reason="needs the extra `ray`: pip install 'sonar-gym[ray]'")

import ray

from acquisition import SettingError
from acquisition.limits import check_settings
from sonar_gym.agent import AgentDriver, load_policy
from training.agents import rllib, sweep

pytestmark = pytest.mark.filterwarnings("ignore")  # of Ray itself


@pytest.fixture(scope="module")
def two_workers():
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield
    ray.shutdown()


def test_the_environment_passes_gymnasium_s_check():
    check_env(rllib.environment({"sonar": "gaussian"}), skip_render_check=True)


def test_the_wrapper_observes_what_an_agent_remembers():
    """An agent's driver, and its policy on the wrapped environment, give the same actions and rewards."""
    policy = load_policy("parking")
    driver = AgentDriver(policy)
    wrapped = rllib.environment({"sonar": "gaussian", "memory": policy.memory.to_dict(), "repeat": policy.repeat})
    plain = gymnasium.make("SonarParking-v0", sonar="gaussian")
    driver.reset()
    shown, _ = wrapped.reset(seed=4)
    observation, _ = plain.reset(seed=4)
    for _ in range(10):
        action = policy.act(shown[None])[0]
        shown, reward, *_ = wrapped.step(action)
        total = 0.0
        for _ in range(policy.repeat):
            own = driver.act(observation)
            assert own == pytest.approx(action, abs=1e-6)
            observation, part, *_ = plain.step(own)
            total += part
        assert reward == pytest.approx(total, abs=1e-6)


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
def test_a_sweep_is_continued(two_workers, tmp_path):
    results = sweep.run(sweep.Args(tmp_path / "sweep", **SMALL))
    assert results["seed"].tolist() == [0, 1]
    assert (results["steps"] > 0).all()
    folders = sorted(path.name for path in (tmp_path / "sweep" / "agents").iterdir())
    assert folders == ["seed=0-learning_rate=0.0001-sonar=ideal", "seed=1-learning_rate=0.0001-sonar=ideal"]
    times = [path.stat().st_mtime for path in (tmp_path / "sweep").glob("agents/*/checkpoint.safetensors")]
    again = sweep.run(sweep.Args(tmp_path / "sweep", **SMALL))
    assert again.equals(results)
    assert times == [path.stat().st_mtime for path in (tmp_path / "sweep").glob("agents/*/checkpoint.safetensors")]


def test_invalid_settings_are_refused():
    with pytest.raises(SettingError, match=r"Args\.workers: expected a whole number from 1 to 256, got 0"):
        check_settings(sweep.Args(workers=0))
