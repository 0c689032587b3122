"""SonarVectorObservation: environment i gets the readings it would get alone, in all three autoreset modes."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from acquisition import Ping
from noise import CATALOGUE, GaussianModel, PhysicalModel
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.learned.recurrent import LstmModel
from noise.learned.recurrent_state import N_ANCHORS, N_HISTORY_FEATURES, LstmCell
from sonar_gym import SonarObservation, SonarVectorObservation

N, STEPS = 3, 14
SETTINGS = {"indices": [0, 1], "metres_per_unit": 0.01, "incidence": "tilt", "reflectance": (0.2, 0.9)}
TIMES = {"period_s": [0.0, 0.25], "phase_s": [0.0, 0.05], "latency_s": [0.12, 0.05]}


class Walk(gymnasium.Env):
    """Two random ranges in cm and a random number; episodes of three to six steps."""

    observation_space = gymnasium.spaces.Box(np.float32([0, 0, -1]), np.float32([1000, 1000, 1]))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def _see(self):
        row = np.array([*self.np_random.uniform(30.0, 500.0, 2), self.np_random.uniform(-1, 1)], dtype=np.float32)
        return row, {"tilt": self.np_random.uniform(0.0, 0.3, 2)}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = int(self.np_random.integers(3, 7))
        return self._see()

    def step(self, action):
        self.left -= 1
        observation, info = self._see()
        return observation, 1.0, self.left == 0, False, info


def lstm():
    rng = np.random.default_rng(3)
    names = ("distance", "angle", "incidence", "reflectance")
    learned_on = Ping.of(distance=[0.1, 2.0, 5.5], angle=[0.0, 0.2, 0.6], incidence=[0.1, 0.0, 0.6], reflectance=0.5)
    inputs, state = Inputs.of(learned_on, names), 6
    head = Head(3, 2, 0.01, 6.0, anchored=N_ANCHORS, fails=True)
    width = inputs.width + N_HISTORY_FEATURES
    cell = LstmCell(*(rng.normal(size=shape) for shape in ((4 * state, width), (4 * state, state), (4 * state,))))
    return LstmModel(inputs, head, cell, [(rng.normal(size=(head.width, width + state)), rng.normal(size=head.width))])


MODELS = {
    "gaussian": lambda: GaussianModel(sigma=0.03, miss=0.1),
    "stale": lambda: PhysicalModel([CATALOGUE["stale_repeat"](probability=0.5)]),
    "lstm": lstm,
}


def same(observation, alone):
    assert set(observation) == set(alone)
    for name, value in observation.items():
        assert np.array_equal(value, alone[name]), name


def same_row(many, i, alone):
    same({name: value[i] for name, value in many.items()}, alone)


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("times", [{}, TIMES], ids=["every step", "timed"])
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_readings_equal_those_of_single_wrappers(mode, times, model):
    model = model()
    envs = SonarVectorObservation(SyncVectorEnv([Walk] * N, autoreset_mode=mode), model, **SETTINGS, **times)
    singles = [SonarObservation(Walk(), model, **SETTINGS, **times) for _ in range(N)]
    observation, _ = envs.reset(seed=5)
    over = np.zeros(N, dtype=bool)
    for i, single in enumerate(singles):
        same_row(observation, i, single.reset(seed=5 + i)[0])
    for _ in range(STEPS):
        if mode is AutoresetMode.DISABLED and over.any():
            observation, _ = envs.reset(options={"reset_mask": over.copy()})
            for i in np.flatnonzero(over):
                same_row(observation, i, singles[i].reset()[0])
            over[:] = False
        observation, _, terminated, _, info = envs.step(np.zeros((N, 1), dtype=np.float32))
        assert observation in envs.observation_space
        for i, single in enumerate(singles):
            if mode is AutoresetMode.NEXT_STEP and over[i]:
                same_row(observation, i, single.reset()[0])
                continue
            alone, _, ended, _, truth = single.step(np.zeros(1, dtype=np.float32))
            assert ended == terminated[i]
            if mode is AutoresetMode.SAME_STEP and ended:
                same(info["final_obs"][i], alone)
                final = info["final_info"]["sonar"]
                assert final["_distance"][i]
                assert np.array_equal(final["distance"][i], truth["sonar"]["distance"])
                alone, truth = single.reset()
            same_row(observation, i, alone)
            assert np.array_equal(info["sonar"]["distance"][i], truth["sonar"]["distance"])
        over = terminated.copy()
    assert envs.sonar.model.remembers == singles[0].sonar.model.remembers


@pytest.mark.parametrize("mode", AutoresetMode)
def test_readings_in_streets_equal_those_of_single_wrappers(mode):
    how = {"latency_s": 0.05, "period_s": 0.2}
    inner = gymnasium.make_vec("SonarParking-v0", N, sonar="gaussian", autoreset_mode=mode, max_episode_steps=6)
    envs = SonarVectorObservation(inner, "srf08-mlp", **how)
    assert set(envs.single_observation_space.spaces) == {"ranges", "credence", "echo", "age", "ego"}
    singles = [
        SonarObservation(gymnasium.make("SonarParking-v0", max_episode_steps=6), "srf08-mlp", **how) for _ in range(N)
    ]
    observation, _ = envs.reset(seed=2)
    for i, single in enumerate(singles):
        same_row(observation, i, single.reset(seed=2 + i)[0])
    rng = np.random.default_rng(0)
    for step in range(1, 7):
        actions = rng.uniform(-1, 1, (N, 2)).astype(np.float32)
        observation, _, _, truncated, info = envs.step(actions)
        for i, single in enumerate(singles):
            alone = single.step(actions[i])[0]
            if step == 6 and mode is AutoresetMode.SAME_STEP:
                same(info["final_obs"][i], alone)
                alone = single.reset()[0]
            same_row(observation, i, alone)
        assert truncated.all() == (step == 6)


def test_replaced_sonars_leave_the_form_of_the_observations():
    inner = gymnasium.wrappers.vector.FlattenObservation(gymnasium.make_vec("SonarParking-v0", N))
    envs = SonarVectorObservation(inner, "gaussian")
    assert envs.single_observation_space == inner.single_observation_space
    assert envs.observation_space == inner.observation_space
    assert envs.reset(seed=0)[0] in envs.observation_space


def test_ranges_in_a_dict_and_infinite_ones():
    class Keyed(Walk):
        observation_space = gymnasium.spaces.Dict(
            {"rays": gymnasium.spaces.Box(0.0, np.inf, (2, 2)), "pose": gymnasium.spaces.Box(-1.0, 1.0, (3,))}
        )

        def _see(self):
            rays = self.np_random.uniform(0.5, 3.0, (2, 2)).astype(np.float32)
            rays[0, 1] = np.inf
            return {"rays": rays, "pose": np.zeros(3, dtype=np.float32)}, {}

    envs = SonarVectorObservation(SyncVectorEnv([Keyed] * 2), "ideal", key="rays")
    observation, info = envs.reset(seed=0)
    assert observation["ranges"].shape == (2, 4)
    assert list(observation["echo"][0]) == [1.0, 0.0, 1.0, 1.0]
    assert observation["pose"].shape == (2, 3)
    assert 6.0 * observation["ranges"][1, 0] == pytest.approx(info["sonar"]["distance"][1, 0], abs=1e-3)
    assert info["_sonar"].all()
    assert observation in envs.observation_space


def test_a_list_of_seeds():
    envs = SonarVectorObservation(SyncVectorEnv([Walk] * 2), "gaussian", **SETTINGS)
    first, _ = envs.reset(seed=[4, 9])
    alone, _ = SonarObservation(Walk(), "gaussian", **SETTINGS).reset(seed=9)
    same_row(first, 1, alone)


def test_the_times_of_a_layout_are_those_of_the_wrapper_unless_set():
    def age(**times):
        inner = gymnasium.make_vec("SonarParking-v0", 2, sonar_layout="eight in turn")
        envs = SonarVectorObservation(inner, **times)
        envs.reset(seed=0)
        return envs.step(np.zeros((2, 2), dtype=np.float32))[0]["age"][0]

    assert len(set(age())) == 4  # four groups of sonars fire in turn
    assert set(age(latency_s=0.0)) == {0.0}


def test_spec_of_a_single_wrapper_makes_vector_environments():
    spec = SonarObservation(gymnasium.make("SonarParking-v0"), "gaussian", period_s=0.2).spec
    again = gymnasium.envs.registration.EnvSpec.from_json(spec.to_json())
    envs = gymnasium.make_vec(again, num_envs=2, vectorization_mode="sync")
    alone = gymnasium.make(again)
    observation, _ = envs.reset(seed=3)
    same_row(observation, 1, alone.reset(seed=4)[0])
