"""Times of pings and of the arrival of their readings: by hand, by enumeration, and many cars against one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import SettingError
from noise import GaussianModel, IdealModel
from sonar_gym.sensing import paths
from sonar_gym.sensing.sonar import Sonar
from sonar_gym.sensing.timing import timing
from sonar_gym.wrappers.sources import ObservedSonars, Paths

STEP = 0.1
ROW = np.zeros(1, dtype=np.int64)


class Walls:
    """Walls in front of every sonar, at distances that the test gives as observation, m, (r, s)."""

    max_range, step_s = 6.0, STEP

    def __init__(self, times, count):
        self.times, self.names = times, tuple(f"sonar {i}" for i in range(count))

    def begin(self, rows, observation, info, rngs):
        """Draw nothing."""

    def hear_others(self, pings):
        """Add nothing."""

    def paths(self, rows, observation, info, rngs):
        distance = np.broadcast_to(np.atleast_1d(np.asarray(observation, dtype=float)), (len(rows), len(self.names)))
        out = np.zeros((*distance.shape, paths.MAX_PATHS, paths.N_PATH))
        out[:, :, 0, paths.DISTANCE], out[:, :, 0, paths.REFLECTANCE] = distance, 0.5
        return Paths(out, np.ones(distance.shape, dtype=np.int64))


class Schedule:
    """Sonars before walls."""

    def __init__(self, period=0.0, phase=0.0, latency=0.0, count=1, model=None, copies=1):
        self.sonar = Sonar(model or IdealModel(), count, 6.0, copies=copies)
        for copy in range(copies):
            self.sonar.seed(copy, copy)
        self.observed = ObservedSonars(Walls((period, phase, latency), count), self.sonar)

    def begin(self, rows, world):
        self.observed.begin(rows, world, {})

    def step(self, rows, world):
        self.observed.step(rows, world, {})

    def observation(self):
        return self.observed.sensing.observation(slice(None))


def observed(schedule, worlds):
    """Return readings, m, and their ages, s, at the observations of walls at some distances, m."""
    out = []
    for k, world in enumerate(worlds):
        (schedule.begin if k == 0 else schedule.step)(ROW, world)
        observation = schedule.observation()
        out.append((6.0 * observation["ranges"][0, 0], observation["age"][0, 0]))
    return np.array(out).T


DISTANCES = 1.0 + 0.1 * np.arange(10)  # m, at 0 s, 0.1 s, ...


def test_without_period_and_latency_readings_are_current():
    ranges, age = observed(Schedule(), DISTANCES)
    assert ranges == pytest.approx(DISTANCES, abs=1e-3)
    assert age == pytest.approx(0.0, abs=1e-9)


def test_without_a_period_readings_arrive_with_the_observation():
    # sent 0.02 s before each observation, from the state at that observation, which is nearest in time
    ranges, age = observed(Schedule(latency=0.02), DISTANCES)
    assert ranges == pytest.approx(DISTANCES, abs=1e-3)
    assert age == pytest.approx([0.0, *[0.02] * 9], abs=1e-6)


def test_latency_is_in_seconds_not_in_steps():
    # sent at 0.03, 0.13, ... s, from the state at 0, 0.1, ... s; 0.17 s later the reading arrives with an observation
    ranges, age = observed(Schedule(latency=0.17), DISTANCES[:5])
    assert ranges == pytest.approx([1.0, 1.0, 1.0, 1.1, 1.2], abs=1e-3)
    assert age == pytest.approx([0.0, 0.1, 0.17, 0.17, 0.17], abs=1e-6)


def test_latency_of_whole_steps_is_exact():
    ranges, _ = observed(Schedule(latency=0.3), DISTANCES)
    assert ranges == pytest.approx([1.0, 1.0, 1.0, 1.0, *DISTANCES[1:7]], abs=1e-3)


def test_latency_of_several_hundred_steps_is_exact():
    walls = 1.0 + 0.01 * np.arange(400)
    ranges, age = observed(Schedule(latency=30.0), walls)
    assert ranges == pytest.approx(walls[np.maximum(np.arange(400) - 300, 0)], abs=1e-3)
    assert age[300:] == pytest.approx(1.0)  # the greatest that is shown


def test_the_real_sensor_pings_at_every_second_observation_if_it_needs_longer_than_a_step():
    when = timing(["a", "b"], 0.02, (0.0, 0.0, [np.nan, 0.01]), 6.0)
    assert when[0] == pytest.approx([0.04, 0.04 - (12.0 / 343.0 + 0.002 - 0.02), 12.0 / 343.0 + 0.002])
    assert when[1] == pytest.approx([0.02, 0.01, 0.01])


def test_pings_between_observations_have_the_conditions_of_the_nearest_one():
    # sent at 0.1, 0.33, 0.56, 0.79 s: from the states at 0.1, 0.3, 0.6 and 0.8 s
    ranges, age = observed(Schedule(period=0.23, phase=0.1), DISTANCES[:9])
    assert ranges == pytest.approx([1.0, 1.1, 1.1, 1.1, 1.3, 1.3, 1.6, 1.6, 1.8], abs=1e-3)
    assert age == pytest.approx([0.0, 0.0, 0.1, 0.2, 0.07, 0.17, 0.04, 0.14, 0.01], abs=1e-6)


def test_each_sonar_has_its_own_period_phase_and_latency():
    schedule = Schedule(period=[0.0, 0.2], phase=[0.0, 0.1], latency=[0.1, 0.0], count=2)
    for k, world in enumerate(DISTANCES[:4]):
        (schedule.begin if k == 0 else schedule.step)(ROW, [world, world])
    assert 6.0 * schedule.observation()["ranges"][0] == pytest.approx([1.2, 1.3], abs=1e-3)


seconds = st.integers(0, 60).map(lambda k: k / 100)


@settings(deadline=None)
@given(st.integers(10, 50), seconds, seconds)
def test_the_latest_reading_that_has_arrived_is_shown(period, phase, latency):
    period /= 100
    schedule = Schedule(period, phase, latency)
    ranges, age = observed(schedule, DISTANCES)
    sent = np.array([phase + k * period for k in range(60)])
    sent = sent[sent > 1e-9]  # the first ping is at the start of the episode
    for k in range(1, len(DISTANCES)):
        now = k * STEP
        arrived = sent[sent + latency <= now + 1e-6]
        last = arrived.max(initial=0.0)
        assert age[k] == pytest.approx(now - last, abs=1e-6)
        assert ranges[k] == pytest.approx(DISTANCES[int(np.ceil(last / STEP - 0.5 - 1e-6))], abs=1e-3)


class Recorder(IdealModel):
    """An ideal sonar that records the previous readings given to it."""

    def law(self, ping, past=None):
        if len(ping) <= 2:
            self.calls.append((ping.run.tolist(), None if past is None else past.range.tolist()))
        return super().law(ping, past)


def test_previous_reading_is_that_of_the_same_sonar():
    model = Recorder(remembers=True)
    object.__setattr__(model, "calls", [])
    schedule = Schedule(period=[0.0, 0.2], phase=[0.0, 0.2], count=2, model=model)
    model.calls.clear()
    schedule.begin(ROW, [1.0, 2.0])
    for k in (1, 2):
        schedule.step(ROW, [1.0 + 0.1 * k, 2.0 + 0.1 * k])
    schedule.begin(ROW, [3.0, 4.0])
    assert model.calls == [([0, 1], None), ([0], [1.0]), ([0, 1], [1.1, 2.0]), ([0, 1], None)]


@pytest.mark.parametrize("times", [{}, {"period": [0.15, 0.4], "phase": [0.0, 0.1], "latency": [0.05, 0.3]}])
def test_many_cars_get_the_same_readings_as_each_car_alone(times):
    model = GaussianModel(sigma=0.05, miss=0.2)
    many = Schedule(count=2, copies=3, model=model, **times)
    alone = [Schedule(count=2, model=model, **times) for _ in range(3)]
    for i, schedule in enumerate(alone):
        schedule.sonar.seed(i)
    rng = np.random.default_rng(0)
    for k in range(12):
        world = rng.uniform(0.5, 5.0, (3, 2))
        resets = np.array([k == 0, k in (0, 4), k == 0])  # the second car is reset once
        for rows, call in ((np.flatnonzero(resets), "begin"), (np.flatnonzero(~resets), "step")):
            if len(rows):
                getattr(many, call)(rows, world[rows])
            for i in rows:
                getattr(alone[i], call)(ROW, world[[i]])
        observation, each = many.observation(), [schedule.observation() for schedule in alone]
        for name, value in observation.items():
            assert np.array_equal(value, np.concatenate([one[name] for one in each]))


def test_invalid_times_raise_an_error():
    with pytest.raises(SettingError, match=r"period_s of 'b' is 0.05 s, less than the 0.1 s from one observation"):
        timing(["a", "b"], STEP, ([0.2, 0.05], 0.0, 0.0), 6.0)
    with pytest.raises(SettingError, match=r"latency_s must be finite and >= 0 s, got .*-1"):
        timing(["a", "b"], STEP, (0.0, 0.0, -1.0), 6.0)
    with pytest.raises(SettingError, match=r"phase_s has shape \(3,\), expected one number or 2, one for each sonar"):
        timing(["a", "b"], STEP, (0.2, [0.0, 0.1, 0.2], 0.0), 6.0)
