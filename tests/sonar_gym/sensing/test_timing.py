"""Times of pings and of the arrival of their readings: by hand, by enumeration, and many cars against one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import SettingError
from noise import GaussianModel, IdealModel
from sonar_gym.sensing.sonar import Sonar
from sonar_gym.sensing.timing import PingConditions, PingSchedule, timing

STEP = 0.1
ROW = np.zeros(1, dtype=np.int64)


def at_normal_incidence(distance, rows=1):
    """Return conditions at some distances, m, and normal incidence, equal for every car."""
    distance = np.broadcast_to(np.atleast_1d(np.asarray(distance, dtype=float)), (rows, np.size(distance)))
    zero = np.zeros_like(distance)
    return PingConditions(distance, zero, zero, zero + 0.5, np.ones_like(distance, dtype=bool))


def make_schedule(period=0.0, phase=0.0, latency=0.0, count=1, model=None, copies=1):
    sonar = Sonar(model or IdealModel(), count, 6.0, copies=copies)
    for copy in range(copies):
        sonar.seed(copy, copy)
    return PingSchedule(sonar, timing(count, STEP, (period, phase, latency)), STEP)


def observed(schedule, worlds):
    """Return readings, m, and their ages, s, at the observations of walls at some distances, m."""
    out = []
    for k, world in enumerate(worlds):
        (schedule.begin if k == 0 else schedule.step)(ROW, at_normal_incidence(world))
        observation = schedule.observation()
        out.append((6.0 * observation["ranges"][0, 0], observation["age"][0, 0]))
    return np.array(out).T


DISTANCES = 1.0 + 0.1 * np.arange(10)  # m, at 0 s, 0.1 s, ...


def test_without_period_and_latency_readings_are_current():
    ranges, age = observed(make_schedule(), DISTANCES)
    assert ranges == pytest.approx(DISTANCES, abs=1e-3)
    assert np.all(age == 0.0)


def test_latency_is_in_seconds_not_in_steps():
    # the ping of 0 s arrives by 0.2 s, that of 0.1 s by 0.3 s
    ranges, age = observed(make_schedule(latency=0.15), DISTANCES[:5])
    assert ranges == pytest.approx([1.0, 1.0, 1.0, 1.1, 1.2], abs=1e-3)
    assert age == pytest.approx([0.0, 0.1, 0.2, 0.2, 0.2], abs=1e-6)


def test_latency_of_whole_steps_is_exact():
    ranges, _ = observed(make_schedule(latency=0.3), DISTANCES)
    assert ranges == pytest.approx([1.0, 1.0, 1.0, 1.0, *DISTANCES[1:7]], abs=1e-3)


def test_pings_between_observations_have_the_conditions_of_the_earlier_one():
    # sent at 0.1, 0.35, 0.6 s, without latency: that of 0.35 s is shown at 0.4 s, with the conditions of 0.3 s
    ranges, age = observed(make_schedule(period=0.25, phase=0.1), DISTANCES[:8])
    assert ranges == pytest.approx([1.0, 1.1, 1.1, 1.1, 1.3, 1.3, 1.6, 1.6], abs=1e-3)
    assert age == pytest.approx([0.0, 0.0, 0.1, 0.2, 0.05, 0.15, 0.0, 0.1], abs=1e-6)


def test_each_sonar_has_its_own_period_phase_and_latency():
    schedule = make_schedule(period=[0.0, 0.2], phase=[0.0, 0.1], latency=[0.1, 0.0], count=2)
    for k, world in enumerate(DISTANCES[:4]):
        (schedule.begin if k == 0 else schedule.step)(ROW, at_normal_incidence([world, world]))
    assert 6.0 * schedule.observation()["ranges"][0] == pytest.approx([1.2, 1.3], abs=1e-3)


seconds = st.integers(0, 60).map(lambda k: k / 100)


@settings(deadline=None)
@given(st.integers(10, 50), seconds, seconds)
def test_the_latest_reading_that_has_arrived_is_shown(period, phase, latency):
    period /= 100
    schedule = make_schedule(period, phase, latency)
    ranges, age = observed(schedule, DISTANCES)
    sent = np.array([phase + k * period for k in range(60)])
    sent = sent[sent > 1e-9]  # the first ping is at the start of the episode
    for k in range(1, len(DISTANCES)):
        now = k * STEP
        arrived = sent[sent + latency <= now + 1e-6]
        last = arrived.max(initial=0.0)
        assert age[k] == pytest.approx(now - last, abs=1e-6)
        assert ranges[k] == pytest.approx(DISTANCES[int(last / STEP + 1e-6)], abs=1e-3)


class Recorder(IdealModel):
    """An ideal sonar that records the previous readings given to it."""

    def law(self, ping, past=None):
        if len(ping) <= 2:
            self.calls.append((ping.run.tolist(), None if past is None else past.range.tolist()))
        return super().law(ping, past)


def test_previous_reading_is_that_of_the_same_sonar():
    model = Recorder(remembers=True)
    object.__setattr__(model, "calls", [])
    schedule = make_schedule(period=[0.0, 0.2], phase=[0.0, 0.2], count=2, model=model)
    model.calls.clear()
    schedule.begin(ROW, at_normal_incidence([1.0, 2.0]))
    for k in (1, 2):
        schedule.step(ROW, at_normal_incidence([1.0 + 0.1 * k, 2.0 + 0.1 * k]))
    schedule.begin(ROW, at_normal_incidence([3.0, 4.0]))
    assert model.calls == [([0, 1], None), ([0], [1.0]), ([0, 1], [1.1, 2.0]), ([0, 1], None)]


@pytest.mark.parametrize("times", [{}, {"period": [0.15, 0.4], "phase": [0.0, 0.1], "latency": [0.05, 0.3]}])
def test_many_cars_get_the_same_readings_as_each_car_alone(times):
    model = GaussianModel(sigma=0.05, miss=0.2)
    many = make_schedule(count=2, copies=3, model=model, **times)
    alone = [make_schedule(count=2, model=model, **times) for _ in range(3)]
    for i, schedule in enumerate(alone):
        schedule.sonar.seed(i)
    rng = np.random.default_rng(0)
    for k in range(12):
        world = rng.uniform(0.5, 5.0, (3, 2))
        resets = np.array([k == 0, k in (0, 4), k == 0])  # the second car is reset once
        for rows, call in ((np.flatnonzero(resets), "begin"), (np.flatnonzero(~resets), "step")):
            if len(rows):
                getattr(many, call)(rows, PingConditions(*(part[rows] for part in conditions_of(world))))
            for i in rows:
                getattr(alone[i], call)(ROW, PingConditions(*(part[[i]] for part in conditions_of(world))))
        observation, each = many.observation(), [schedule.observation() for schedule in alone]
        for name, value in observation.items():
            assert np.array_equal(value, np.concatenate([one[name] for one in each]))


def conditions_of(world):
    zero = np.zeros_like(world)
    return world, zero, zero, zero + 0.5, np.ones_like(world, dtype=bool)


def test_invalid_times_raise_an_error():
    with pytest.raises(SettingError, match=r"period_s is 0.05 s, less than the 0.1 s from one observation to the next"):
        timing(2, STEP, (0.05, 0.0, 0.0))
    with pytest.raises(SettingError, match="latency_s must be finite and >= 0 s, got -1"):
        timing(2, STEP, (0.0, 0.0, -1.0))
    with pytest.raises(SettingError, match=r"phase_s has shape \(3,\), expected one number or 2, one for each sonar"):
        timing(2, STEP, (0.2, [0.0, 0.1, 0.2], 0.0))
