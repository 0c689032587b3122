"""The parking car in an OpenDLV session, and the agent at its wheel."""

import threading
import time
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import NoAnswerError, SettingError
from sonar_gym.agent import load_agent
from sonar_gym.bridges.opendlv.agent import AgentOptions, SessionAgent
from sonar_gym.bridges.opendlv.car import CarOptions, Controls, SessionCar
from sonar_gym.bridges.opendlv.messages import FRAME, KINEMATICS, PEDAL, READING, STEERING
from sonar_gym.bridges.opendlv.session import Session, seconds_of, time_of
from sonar_gym.bridges.opendlv.wire import Envelope
from sonar_gym.parking.environment import MAX_STEPS, STEP_S, SonarParkingEnv

SEED = 0
QUIET_STREET = 4  # seed of a street in which some sonars hear nothing at first
LOCK_STEP = CarOptions(lock_step=True, patience_s=60.0)


@pytest.fixture(scope="module")
def env():
    return SonarParkingEnv(sonar="srf08-mlp")


@pytest.fixture(scope="module")
def direct(env):
    """Steps of the agent on the street without a session."""
    driver = load_agent()
    observation, _ = env.reset(seed=SEED)
    driver.reset()
    for step in range(1, 401):
        observation, _, ended, _, info = env.step(driver.act(observation))
        if ended:
            return info["is_success"], step
    return False, 400


class LossyLink:
    """A link that loses and doubles datagrams."""

    def __init__(self, link, seed, loss=0.1, doubling=0.1):
        self.link, self._rng, self._loss, self._doubling = link, np.random.default_rng(seed), loss, doubling

    def send(self, datagram):
        draw = self._rng.random()
        for _ in range(0 if draw < self._loss else 2 if draw < self._loss + self._doubling else 1):
            self.link.send(datagram)

    def receive(self, timeout_s):
        return self.link.receive(timeout_s)

    def close(self):
        self.link.close()


def drive_with_agent(env, car_session, agent_session, seeds=(SEED,), max_steps=MAX_STEPS):
    agent = SessionAgent(agent_session, options=AgentOptions(patience_s=3.0))

    def work():
        with suppress(NoAnswerError, OSError, ValueError):
            agent.run(120.0)

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    car = SessionCar(car_session, env, LOCK_STEP)
    outcomes = [car.drive(seed, max_steps) for seed in seeds]
    agent_session.close()  # ends the agent, which would wait for another Frame
    worker.join(10.0)
    return outcomes


def test_the_agent_parks_our_car_through_the_session_as_it_does_without(env, direct, pair):
    (outcome, second) = drive_with_agent(env, *pair, seeds=(SEED, SEED))
    assert direct[0]
    assert outcome.parked
    assert abs(outcome.steps - direct[1]) <= 5  # values travel as 32-bit floats
    assert second.parked  # a second drive begins with empty memory


def test_lost_and_doubled_datagrams_do_not_stop_the_drive(env, pair):
    one, two = (Session(LossyLink(session.link, k)) for k, session in enumerate(pair))
    (outcome,) = drive_with_agent(env, one, two, max_steps=100)
    assert outcome.steps > 30  # without readings it may park or not, but it drives


def test_every_step_ends_with_its_frame_and_silent_sonars_send_nothing(env, pair):
    car_session, driver = pair
    found, steps = [], 5

    def work():
        sent = 0
        while sent < steps:
            envelope = driver.receive(30.0)
            found.append(envelope)
            if envelope.message == FRAME:
                driver.send(STEERING, {"groundSteering": 0.1})
                driver.send(PEDAL, {"position": 0.14})
                sent += 1
        while (envelope := driver.receive(0.5)) is not None:
            found.append(envelope)

    worker = threading.Thread(target=work)
    worker.start()
    outcome = SessionCar(car_session, env, LOCK_STEP).drive(QUIET_STREET, steps)
    worker.join()
    assert (outcome.steps, outcome.parked) == (steps, False)
    frames = [k for k, e in enumerate(found) if e.message == FRAME]
    assert len(frames) == steps + 1
    assert all(found[k - 1].message == KINEMATICS for k in frames)
    at = [seconds_of(found[k].sampled) for k in frames]
    np.testing.assert_allclose(np.diff(at), STEP_S, atol=2e-6)
    assert found[frames[-1]].fields["x"] > found[frames[0]].fields["x"]
    assert found[frames[-1] - 1].fields["yawRate"] > 0.0
    readings = [e for e in found if e.message == READING]
    assert 0 < len(readings) < len(env.mounts) * (steps + 1)
    assert all(0.0 < e.fields["distance"] <= 3.01 for e in readings)
    assert all(
        min(abs(seconds_of(e.sampled) + delay - t) for t in at for delay in (0.0, 0.02)) < 1e-3 for e in readings
    )


def test_a_car_without_a_driver_gives_up_in_lock_step(env, pair):
    with pytest.raises(NoAnswerError, match=f"no {PEDAL} with senderStamp 0 for 0.3 s"):
        SessionCar(pair[0], env, CarOptions(lock_step=True, patience_s=0.3)).drive(SEED)


def test_requests_to_others_doubled_and_late_ones_drive_no_step(env, pair):
    car = SessionCar(pair[0], env, CarOptions(lock_step=True, patience_s=0.6))
    for _ in range(3):
        pair[1].send(PEDAL, {"position": 0.14}, 4, sampled=1.0)  # to another car
        pair[1].send(PEDAL, {"position": np.nan}, 0, sampled=2.0)
        pair[1].send(PEDAL, {"position": 0.14}, 0, sampled=3.0)  # one request, three times
    with pytest.raises(NoAnswerError):
        car.drive(SEED)
    assert env.world.steps == 1


def test_a_driver_that_vanishes_is_braked_in_real_time(env, pair):
    car = SessionCar(pair[0], env, CarOptions(hold_s=0.25))
    pair[1].send(PEDAL, {"position": 0.14})
    begin = time.monotonic()
    outcome = car.drive(SEED, 12)
    assert time.monotonic() - begin == pytest.approx(1.2, abs=0.3)
    assert outcome.steps == 12
    assert abs(env.car.speed) < 0.05
    assert env.car.pose[0] > 0.05  # it had driven


def test_an_agent_without_a_car_stops(pair):
    agent = SessionAgent(pair[0], options=AgentOptions(patience_s=0.2))
    with pytest.raises(NoAnswerError, match=r"no opendlv\.sim\.Frame with senderStamp 0"):
        agent.run()


@pytest.mark.parametrize(("later_s", "x", "clock_s"), [(0.1, 0.05, 0.1), (0.1, 2.0, 0.0), (5.0, 0.05, 0.0)])
def test_a_pause_or_a_jump_begins_a_new_drive(pair, later_s, x, clock_s):
    agent = SessionAgent(pair[0])
    for seconds, at in ((1000.0, 0.0), (1000.0 + later_s, x)):
        stamp = time_of(seconds)
        assert agent.take(Envelope(FRAME, {"x": at, "y": 0.0, "yaw": 0.0}, 0, stamp, stamp, stamp))
    assert agent.observation(1000.0 + later_s)["ego"][6] * 40.0 == pytest.approx(clock_s, abs=1e-4)


@given(st.floats(-1.0, 1.0))
def test_pedals_are_inverse_to_speeds(speed):
    controls = Controls()
    assert controls.speed_of(controls.pedal_of(speed)) == pytest.approx(speed)
    assert -0.9 <= controls.pedal_of(speed) <= 0.14


def test_controls_are_positive():
    with pytest.raises(SettingError, match=r"Controls.max_speed must be > 0, got 0"):
        Controls(max_speed=0.0)
