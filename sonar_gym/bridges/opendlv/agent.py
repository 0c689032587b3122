"""The trained parking agent at the wheel of a car in an OpenDLV session: ours or theirs.

It listens to Frame, KinematicState and DistanceReading, and sends steering and pedal requests at every Frame that is at
least 0.1 s later than the one before. A sensor that has published nothing for a while has no echo: OpenDLV's drivers
publish nothing then.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from acquisition import EchoStatus, NoAnswerError, Reading
from acquisition.arrays import Floats, Singles
from sonar_gym.agent import AgentDriver, Policy, load_policy
from sonar_gym.bridges.opendlv.car import Controls
from sonar_gym.bridges.opendlv.messages import FRAME, KINEMATICS, PEDAL, READING, STEERING
from sonar_gym.bridges.opendlv.session import Session, seconds_of
from sonar_gym.bridges.opendlv.wire import Envelope
from sonar_gym.parking.fleet import MAX_RANGE, MAX_STEPS, ODOMETRY_SPAN, STEP_S, Fleet
from sonar_gym.sensing.mounts import LAYOUTS
from sonar_gym.sensing.records import MAX_AGE_S, SAME_TIME_S
from sonar_gym.sensing.sonar import SonarChoice
from sonar_gym.sensing.timing import sensor_latency

US_S = 1e-6  # step of a time stamp, s
JUMP_SPEEDS, JUMP_M = 3.0, 0.05  # a Frame further away than so many times the maximum speed, and m, begins a new drive
MAX_GAP_S = 1.0  # longest time between two Frames of one drive
MIN_SPEED = 0.02  # m/s, above which the steering angle follows from the yaw rate


@dataclass(frozen=True)
class AgentOptions:
    """How the agent takes part in a session.

    Attributes:
        frame_id: senderStamp of the car's Frame and KinematicState.
        request_id: senderStamp of the requests.
        first_sensor: senderStamp of the first sonar; the others follow in the order of the layout "eight".
        silent_after_s: age of a reading from which its sensor counts as one without an echo, s.
        patience_s: time without a Frame after which the agent stops, s.
        sonar: model for the credence of the readings.
        controls: what requests mean to the car.
    """

    frame_id: int = 0
    request_id: int = 0
    first_sensor: int = 0
    silent_after_s: float = 0.15
    patience_s: float = 60.0
    sonar: SonarChoice = "srf08-mlp"
    controls: Controls = field(default_factory=Controls)


class SessionAgent:
    """An agent that drives one car of a session.

    Args:
        session: the session.
        policy: the agent; the shipped one by default.
        options: how it takes part.
    """

    def __init__(self, session: Session, policy: Policy | None = None, options: AgentOptions | None = None) -> None:
        self.session, self.options = session, options or AgentOptions()
        self._driver = AgentDriver(load_policy("parking") if policy is None else policy)
        self._sonar = Fleet(1, self.options.sonar).sonar
        self.count = len(LAYOUTS["eight"])
        self._range, self._at = np.zeros(self.count), np.full(self.count, -np.inf)  # m and s
        self._speed = self._turn = self._steering = 0.0  # m/s, rad/s, rad
        self._acted, self._start, self._pose = -np.inf, np.zeros(3), np.full(3, np.nan)
        self._begin, self._seen, self._last = 0.0, 0.0, (0.0, 0.0)
        self.actions = 0

    def run(self, duration_s: float = np.inf) -> None:
        """Drive until a time has passed, s.

        Raises:
            NoAnswerError: there was no Frame for `patience_s`.
        """
        end = time.monotonic() + duration_s
        heard = time.monotonic()
        while (now := time.monotonic()) < end:
            if now - heard > self.options.patience_s:
                raise NoAnswerError(
                    f"OpenDLV: no {FRAME} with senderStamp {self.options.frame_id} for {self.options.patience_s:g} s; "
                    "start the car"
                )
            envelope = self.session.receive(min(end - now, 0.5))
            if envelope is not None and self.take(envelope):
                heard = time.monotonic()

    def take(self, envelope: Envelope) -> bool:
        """Take a message, and act if it is due; return whether it was the car's Frame."""
        values = envelope.fields
        if not np.all(np.isfinite(list(values.values()))):
            return False
        sensor = envelope.sender_stamp - self.options.first_sensor
        if envelope.message == READING and 0 <= sensor < self.count:
            self._range[sensor], self._at[sensor] = values["distance"], seconds_of(envelope.sampled)
        if envelope.sender_stamp != self.options.frame_id:
            return False
        if envelope.message == KINEMATICS:
            self._speed, self._turn = values["vx"], values["yawRate"]
        if envelope.message != FRAME:
            return False
        self._follow(np.array([values["x"], values["y"], values["yaw"]]), seconds_of(envelope.sampled))
        return True

    def _follow(self, pose: Floats, now: float) -> None:
        """Act on a Frame: begin a drive, drive on, or repeat the requests of a Frame that came again."""
        if self._jumped(pose, now):
            self._driver.reset()
            self._start, self._begin, self._acted, self._steering = pose, now, -np.inf, 0.0
        self._pose, self._seen = pose, now
        if now - self._acted >= STEP_S - 2 * US_S or now < self._acted - SAME_TIME_S:
            action = self._driver.act(self.observation(now))
            self._last, self._acted = (float(action[0]), float(action[1])), now
            self.actions += 1
        elif now != self._acted:
            return
        controls, stamp = self.options.controls, self.options.request_id
        self._steering = self._last[0] * controls.max_steering
        self.session.send(STEERING, {"groundSteering": self._steering}, stamp, now)
        self.session.send(PEDAL, {"position": controls.pedal_of(self._last[1])}, stamp, now)

    def _jumped(self, pose: Floats, now: float) -> bool:
        """Return whether a new drive begins: after a pause, or at a pose to which the car cannot have driven."""
        if abs(now - self._seen) > MAX_GAP_S:
            return True
        reach = JUMP_SPEEDS * self.options.controls.max_speed * max(now - self._seen, 0.0) + JUMP_M
        return not np.hypot(*(pose - self._pose)[:2]) <= reach

    def observation(self, now: float) -> dict[str, Singles]:
        """Return the observation of `SonarParking-v0` at a time, s since 1970; see its observation space."""
        age = now - self._at
        echo = (
            (age >= -STEP_S) & (age <= self.options.silent_after_s) & (self._range > 0.0) & (self._range <= MAX_RANGE)
        )
        range_ = np.where(echo, self._range, 0.0)
        reading = Reading(range_, np.where(echo, EchoStatus.ECHO, EchoStatus.NO_ECHO).astype(np.uint8))
        values = {
            "ranges": np.where(echo, range_ / MAX_RANGE, 1.0),
            "credence": self._sonar.credence(reading),
            "echo": echo,
            "age": np.clip(np.where(echo, age, sensor_latency(MAX_RANGE)), 0.0, MAX_AGE_S),
            "ego": np.clip(self._ego(now), -1.0, 1.0),
        }
        return {name: value.astype(np.float32) for name, value in values.items()}

    def _ego(self, now: float) -> Floats:
        controls, steering = self.options.controls, self._steering
        if abs(self._speed) > MIN_SPEED:
            steering = float(np.arctan(self._turn * controls.wheelbase / self._speed))
        turn, (dx, dy) = self._pose[2] - self._start[2], (self._pose - self._start)[:2]
        c, s = np.cos(self._start[2]), np.sin(self._start[2])
        along, across = (c * dx + s * dy) / ODOMETRY_SPAN[0], (c * dy - s * dx) / ODOMETRY_SPAN[1]
        clock = (now - self._begin) / (MAX_STEPS * STEP_S)
        scaled = self._speed / controls.max_speed, steering / controls.max_steering
        return np.array([*scaled, np.cos(turn), np.sin(turn), along, across, clock])
