"""When sonars ping and are heard: by hand, by counting pings out, and one car like many."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import SettingError
from noise import GaussianModel, IdealModel
from sonar_gym.sensing.sonar import Sonar
from sonar_gym.sensing.timing import ConeConditions, ScheduledSonar, timing

STEP = 0.1
ROW = np.zeros(1, dtype=np.int64)


def facing(distance, rows=1):
    """Met squarely at some distances, m, the same for every car."""
    distance = np.broadcast_to(np.atleast_1d(np.asarray(distance, dtype=float)), (rows, np.size(distance)))
    zero = np.zeros_like(distance)
    return ConeConditions(distance, zero, zero, zero + 0.5, np.ones_like(distance, dtype=bool))


def listener(period=0.0, phase=0.0, latency=0.0, count=1, model=None, copies=1):
    sonar = Sonar(model or IdealModel(), count, 6.0, copies=copies)
    for copy in range(copies):
        sonar.seed(copy, copy)
    return ScheduledSonar(sonar, timing(count, STEP, (period, phase, latency)), STEP)


def heard(ears, worlds):
    """What is read at each observation of a world that is so far away, m, and how old it is, s."""
    out = []
    for k, world in enumerate(worlds):
        (ears.begin if k == 0 else ears.step)(ROW, facing(world))
        said = ears.observation()
        out.append((6.0 * said["ranges"][0, 0], said["age"][0, 0]))
    return np.array(out).T


WORLDS = 1.0 + 0.1 * np.arange(10)  # m, at 0 s, 0.1 s, ...


def test_without_times_what_is_read_is_what_is_there():
    said, age = heard(listener(), WORLDS)
    assert said == pytest.approx(WORLDS, abs=1e-3)
    assert np.all(age == 0.0)


def test_latency_delays_by_seconds_not_by_steps():
    said, age = heard(listener(latency=0.15), WORLDS[:5])  # in by 0.2 s is what was sent at 0 s; at 0.3 s, 0.1 s
    assert said == pytest.approx([1.0, 1.0, 1.0, 1.1, 1.2], abs=1e-3)
    assert age == pytest.approx([0.0, 0.1, 0.2, 0.2, 0.2], abs=1e-6)


def test_latency_of_whole_steps_is_not_a_step_late():
    said, _ = heard(listener(latency=0.3), WORLDS)
    assert said == pytest.approx([1.0, 1.0, 1.0, 1.0, *WORLDS[1:7]], abs=1e-3)


def test_pings_between_observations_meet_the_world_of_the_first():
    # sent at 0.1, 0.35, 0.6 s, and heard at once: that of 0.35 s is seen at 0.4 s, and met the world of 0.3 s
    said, age = heard(listener(period=0.25, phase=0.1), WORLDS[:8])
    assert said == pytest.approx([1.0, 1.1, 1.1, 1.1, 1.3, 1.3, 1.6, 1.6], abs=1e-3)
    assert age == pytest.approx([0.0, 0.0, 0.1, 0.2, 0.05, 0.15, 0.0, 0.1], abs=1e-6)


def test_each_sonar_has_times_of_its_own():
    ears = listener(period=[0.0, 0.2], phase=[0.0, 0.1], latency=[0.1, 0.0], count=2)
    for k, world in enumerate(WORLDS[:4]):
        (ears.begin if k == 0 else ears.step)(ROW, facing([world, world]))
    assert 6.0 * ears.observation()["ranges"][0] == pytest.approx([1.2, 1.3], abs=1e-3)


seconds = st.integers(0, 60).map(lambda k: k / 100)


@settings(deadline=None)
@given(st.integers(10, 50), seconds, seconds)
def test_shown_is_the_newest_ping_that_has_come_in(period, phase, latency):
    period /= 100
    ears = listener(period, phase, latency)
    said, age = heard(ears, WORLDS)
    sent = np.array([phase + k * period for k in range(60)])
    sent = sent[sent > 1e-9]  # whatever is sent when the episode begins is that first ping
    for k in range(1, len(WORLDS)):
        now = k * STEP
        in_by_now = sent[sent + latency <= now + 1e-6]
        last = in_by_now.max(initial=0.0)
        assert age[k] == pytest.approx(now - last, abs=1e-6)
        assert said[k] == pytest.approx(WORLDS[int(last / STEP + 1e-6)], abs=1e-3)


class Recorder(IdealModel):
    """An ideal sonar that remembers, and keeps what it was told of the past."""

    def law(self, ping, past=None):
        if len(ping) <= 2:
            self.asked.append((ping.run.tolist(), None if past is None else past.range.tolist()))
        return super().law(ping, past)


def test_memory_is_of_the_sonar_s_own_ping_before():
    model = Recorder(remembers=True)
    object.__setattr__(model, "asked", [])
    ears = listener(period=[0.0, 0.2], phase=[0.0, 0.2], count=2, model=model)
    model.asked.clear()
    ears.begin(ROW, facing([1.0, 2.0]))
    for k in (1, 2):
        ears.step(ROW, facing([1.0 + 0.1 * k, 2.0 + 0.1 * k]))
    ears.begin(ROW, facing([3.0, 4.0]))
    assert model.asked == [([0, 1], None), ([0], [1.0]), ([0, 1], [1.1, 2.0]), ([0, 1], None)]


@pytest.mark.parametrize("times", [{}, {"period": [0.15, 0.4], "phase": [0.0, 0.1], "latency": [0.05, 0.3]}])
def test_many_cars_hear_what_each_hears_alone(times):
    model = GaussianModel(sigma=0.05, miss=0.2)
    many = listener(count=2, copies=3, model=model, **times)
    alone = [listener(count=2, model=model, **times) for _ in range(3)]
    for i, ears in enumerate(alone):
        ears.sonar.seed(i)
    rng = np.random.default_rng(0)
    for k in range(12):
        world = rng.uniform(0.5, 5.0, (3, 2))
        again = np.array([k == 0, k in (0, 4), k == 0])  # the second car begins anew once
        for rows, call in ((np.flatnonzero(again), "begin"), (np.flatnonzero(~again), "step")):
            if len(rows):
                getattr(many, call)(rows, ConeConditions(*(part[rows] for part in facing_each(world))))
            for i in rows:
                getattr(alone[i], call)(ROW, ConeConditions(*(part[[i]] for part in facing_each(world))))
        said, each = many.observation(), [ears.observation() for ears in alone]
        for name, value in said.items():
            assert np.array_equal(value, np.concatenate([one[name] for one in each]))


def facing_each(world):
    zero = np.zeros_like(world)
    return world, zero, zero, zero + 0.5, np.ones_like(world, dtype=bool)


def test_impossible_times_are_refused():
    with pytest.raises(SettingError, match=r"period_s is 0.05 s, less than the 0.1 s from one observation to the next"):
        timing(2, STEP, (0.05, 0.0, 0.0))
    with pytest.raises(SettingError, match="latency_s must be finite and >= 0 s, got -1"):
        timing(2, STEP, (0.0, 0.0, -1.0))
    with pytest.raises(SettingError, match=r"phase_s has shape \(3,\), expected one number or 2, one for each sonar"):
        timing(2, STEP, (0.2, [0.0, 0.1, 0.2], 0.0))
