"""The parking car in an OpenDLV session: it takes steering and pedal requests and sends what their cars send.

After every step of 0.1 s it sends the readings of its sonars (senderStamp: place in the layout), KinematicState and
Frame, in this order, so that a Frame ends the messages of a step. The frame is at the middle of the rear axle. In lock
step the car drives one step for each new pedal request, with the last steering request, and waits in between.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from acquisition import EchoStatus, NoAnswerError, SettingError
from acquisition.limits import check_settings
from sonar_gym.bridges.opendlv.messages import FRAME, KINEMATICS, PEDAL, READING, STEERING, Time
from sonar_gym.bridges.opendlv.session import Session, time_of
from sonar_gym.bridges.opendlv.wire import Envelope
from sonar_gym.parking.environment import MAX_STEPS, STEP_S, SonarParkingEnv
from sonar_gym.sensing import records

REMEMBERED = 64  # Frames


@dataclass(frozen=True)
class Controls:
    """What requests mean to a car; the Kiwi car takes pedals from -0.9 to 0.14 and steering angles within 0.29 rad.

    Attributes:
        forward, reverse: pedal positions at full speed forwards and, without their sign, backwards.
        max_steering: steering angle at full lock, rad.
        max_speed: speed at full pedal, m/s.
        wheelbase: distance between the axles, m.
    """

    forward: float = 0.14
    reverse: float = 0.9
    max_steering: float = float(np.radians(30.0))
    max_speed: float = 0.5
    wheelbase: float = 0.26

    def __post_init__(self) -> None:
        """Raise SettingError for values that are not positive."""
        check_settings(self)
        for name in ("forward", "reverse", "max_steering", "max_speed", "wheelbase"):
            if getattr(self, name) <= 0.0:
                raise SettingError(f"Controls.{name} must be > 0, got {getattr(self, name):g}")

    def speed_of(self, pedal: float) -> float:
        """Return the speed as a fraction of the maximum, within -1..1, for a pedal position."""
        return float(np.clip(pedal / (self.forward if pedal > 0.0 else self.reverse), -1.0, 1.0))

    def pedal_of(self, speed: float) -> float:
        """Return the pedal position for a speed as a fraction of the maximum.

        >>> controls = Controls()
        >>> controls.speed_of(controls.pedal_of(-0.5))
        -0.5
        """
        return speed * (self.forward if speed > 0.0 else self.reverse)


@dataclass(frozen=True)
class CarOptions:
    """How the car takes part in a session.

    Attributes:
        frame_id: senderStamp of its Frame and KinematicState.
        request_id: senderStamp of the requests that it obeys.
        lock_step: drive one step for each pedal request, instead of in real time.
        hold_s: in real time, how long a request is obeyed before the car brakes, s.
        repeat_s: in lock step, time without a request after which the state is sent again, s.
        patience_s: in lock step, time without a request after which the car gives up, s.
        controls: what requests mean.
    """

    frame_id: int = 0
    request_id: int = 0
    lock_step: bool = False
    hold_s: float = 0.5
    repeat_s: float = 0.2
    patience_s: float = 10.0
    controls: Controls = field(default_factory=Controls)


@dataclass(frozen=True)
class Outcome:
    """How a drive ended: parked, touched an obstacle, left the street, or none of these after `steps` steps."""

    parked: bool
    collision: bool
    left_street: bool
    steps: int


class SessionCar:
    """The car of an environment in a session.

    Args:
        session: the session.
        env: the environment; its observations are not used, its car and sonars are.
        options: how the car takes part.
    """

    def __init__(self, session: Session, env: SonarParkingEnv, options: CarOptions | None = None) -> None:
        self.session, self.env, self.options = session, env, options or CarOptions()
        self._steering = self._pedal = 0.0
        self._sampled: Time | None = None  # of the last pedal request
        self._frames: deque[Time] = deque(maxlen=REMEMBERED)  # sample times of the last Frames
        self._obeyed = 0.0  # when it came, s
        self._ended = -np.inf  # simulated end of the last drive, s since 1970
        self._published = np.full(len(env.mounts), -np.inf)  # time of the last published ping of each sonar, s

    def drive(self, seed: int, max_steps: int = MAX_STEPS) -> Outcome:
        """Drive along the street of a seed until the car has parked, touched something, or time is up.

        Raises:
            NoAnswerError: in lock step, nobody has sent a request for `patience_s`.
        """
        self.env.reset(seed=seed)
        self._steering = self._pedal = 0.0
        self._published[:] = -np.inf
        # simulated time may have run ahead of the clock; time stamps never decrease
        origin, start, steps = max(self.session.clock(), self._ended + STEP_S), time.monotonic(), 0
        info: dict[str, Any] = {}
        self._publish(origin)
        for steps in range(1, max(max_steps, 1) + 1):
            if self.options.lock_step:
                self._await_request(origin)
            else:
                self._listen(start + steps * STEP_S)
            action = [self._steering / self.options.controls.max_steering, self._speed()]
            _, _, ended, _, info = self.env.step(np.clip(action, -1.0, 1.0))
            self._publish(origin)
            if ended:
                break
        self._ended = origin + steps * STEP_S
        return Outcome(info["is_success"], info["collision"], info["left_street"], steps)

    def _speed(self) -> float:
        return self.options.controls.speed_of(self._pedal)

    # ---- in ----------------------------------------------------------------------------------------------------------

    def _take(self, envelope: Envelope) -> bool:
        """Obey a request; return whether it is a new pedal request.

        Requests to others are ignored, and in lock step answers to earlier Frames, which bear their sample times.
        """
        late = self.options.lock_step and envelope.sampled in list(self._frames)[:-1]
        if late or envelope.sender_stamp != self.options.request_id:
            return False
        if envelope.message == STEERING and np.isfinite(envelope.fields["groundSteering"]):
            self._steering = envelope.fields["groundSteering"]
        if envelope.message != PEDAL or not np.isfinite(envelope.fields["position"]):
            return False
        new, self._sampled = envelope.sampled != self._sampled, envelope.sampled
        self._pedal = envelope.fields["position"]
        return new

    def _listen(self, until: float) -> None:
        """Take requests until a time, s; brake if the driver is silent."""
        while (left := until - time.monotonic()) > 0.0:
            envelope = self.session.receive(left)
            if envelope is not None and self._take(envelope):
                self._obeyed = time.monotonic()
        if time.monotonic() - self._obeyed > self.options.hold_s:
            self._pedal = 0.0

    def _await_request(self, origin: float) -> None:
        """Wait for a new pedal request; a lost datagram is made up for by sending the state again."""
        end = time.monotonic() + self.options.patience_s
        while (now := time.monotonic()) < end:
            repeat = min(now + self.options.repeat_s, end)
            while (left := repeat - time.monotonic()) > 0.0:
                envelope = self.session.receive(left)
                if envelope is not None and self._take(envelope):
                    return
            self._send_state(origin)
        raise NoAnswerError(
            f"OpenDLV: no {PEDAL} with senderStamp {self.options.request_id} for {self.options.patience_s:g} s; "
            "start the driver, or drive in real time"
        )

    # ---- out ---------------------------------------------------------------------------------------------------------

    def _publish(self, origin: float) -> None:
        shown = self.env.fleet.sensing.pings.of_shown(0)
        sent, status, range_ = (shown[:, k] for k in (records.SENT, records.STATUS, records.RANGE))
        for i in np.flatnonzero((sent > self._published) & (status == EchoStatus.ECHO)):
            self.session.send(READING, {"distance": float(range_[i])}, int(i), origin + float(sent[i]))
        self._published = sent.copy()
        self._send_state(origin)

    def _send_state(self, origin: float) -> None:
        car, now = self.env.car, origin + self.env.world.steps * STEP_S
        x, y, yaw = map(float, car.pose)
        turn = car.speed * float(np.tan(car.steering)) / car.settings.wheelbase
        states: dict[str, dict[str, Any]] = {
            KINEMATICS: {"vx": car.speed, "yawRate": turn},
            FRAME: {"x": x, "y": y, "yaw": yaw},
        }
        if time_of(now) not in self._frames:
            self._frames.append(time_of(now))
        for message, fields in states.items():
            self.session.send(message, fields, self.options.frame_id, now)
