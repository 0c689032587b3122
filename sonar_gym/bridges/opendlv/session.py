"""OpenDLV sessions: datagrams by UDP to a multicast group.

A session with number CID is the group 225.0.0.CID, port 12175. Without a time to live (the default) nothing leaves this
machine, and datagrams from other machines are ignored.
"""

from __future__ import annotations

import select
import socket
import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Protocol

from acquisition import DeviceError, SettingError
from acquisition.arguments import checked
from acquisition.limits import Limit, check_number
from sonar_gym.bridges.opendlv.messages import MAX_DATAGRAM, MESSAGES, Time, encode
from sonar_gym.bridges.opendlv.wire import Envelope, decode

PORT = 12175
FIRST_CID, LAST_CID = 1, 254
US = 1_000_000
TIME = Limit(-(2.0**31), 2.0**31 - 1.0, "s")
BUFFER = 4 * 2**20  # bytes that the system may hold for a receiver that is late
Address = tuple[str, int]
Clock = Callable[[], float]  # s since 1970


@checked
def time_of(seconds: Annotated[float, TIME]) -> Time:
    """Return a time in s as seconds and microseconds.

    >>> time_of(1.25)
    (1, 250000)
    """
    whole, part = divmod(round(seconds * US), US)
    return whole, part


@checked
def seconds_of(time_: Time) -> float:
    """Return seconds and microseconds as a time in s."""
    return time_[0] + time_[1] / US


class Link(Protocol):
    """Where datagrams go to and come from."""

    def send(self, datagram: bytes) -> None:
        """Send a datagram."""
        ...

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next datagram of another sender, or None after a time, s."""
        ...

    def close(self) -> None:
        """Close the sockets."""
        ...


class MulticastLink:
    """The multicast group of a session.

    Args:
        cid: number of the session, 1 to 254.
        ttl: number of networks that a datagram may cross; 0 stays on this machine.

    Raises:
        SettingError: a number is outside its limits.
        DeviceError: this machine has no route for the group.
    """

    def __init__(self, cid: int, ttl: int = 0) -> None:
        check_number("OpenDLV cid", cid, Limit(FIRST_CID, LAST_CID), whole=True)
        check_number("OpenDLV ttl", ttl, Limit(0, 255, "networks"), whole=True)
        group = f"225.0.0.{cid}"
        self._group, self._local = (group, PORT), ttl == 0
        self._receiver = _udp()
        self._sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._receiver.bind(self._group)
            member = struct.pack("4s4s", socket.inet_aton(group), socket.inet_aton("0.0.0.0"))
            self._receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            self._sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, ttl)
            self._sender.connect(self._group)
        except OSError as error:
            self.close()
            raise DeviceError(
                f"OpenDLV session {cid}: cannot join {group} ({error.strerror}); give the group a route: "
                "`ip link set lo up; ip route add 225.0.0.0/24 dev lo`"
            ) from None
        self._own: Address = self._sender.getsockname()

    def send(self, datagram: bytes) -> None:
        """Send a datagram to the group; what the system cannot take now is lost, as on any network."""
        _send(self._sender, datagram)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next datagram of another sender, or None after a time, s."""
        return _receive(self._receiver, timeout_s, self._is_welcome)

    def _is_welcome(self, sender: Address) -> bool:
        if sender == self._own:
            return False
        return not self._local or sender[0] == self._own[0] or sender[0].startswith("127.")

    def close(self) -> None:
        """Leave the group."""
        self._receiver.close()
        self._sender.close()


def _udp() -> socket.socket:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
    udp.setblocking(False)
    return udp


def _send(udp: socket.socket, datagram: bytes) -> None:
    if len(datagram) > MAX_DATAGRAM:
        raise SettingError(f"OpenDLV datagram has {len(datagram)} bytes, at most {MAX_DATAGRAM} fit")
    try:
        udp.send(datagram)
    except (BlockingIOError, ConnectionRefusedError):
        return  # nobody listens yet, or the queue is full: UDP promises no delivery
    except OSError as error:
        raise DeviceError(f"OpenDLV: cannot send ({error.strerror}); is the network up?") from None


def _receive(udp: socket.socket, timeout_s: float, is_welcome: Callable[[Address], bool]) -> bytes | None:
    """Return the next welcome datagram. Others do not extend the time."""
    end = time.monotonic() + timeout_s
    while True:
        try:
            datagram, sender = udp.recvfrom(MAX_DATAGRAM)
        except BlockingIOError:
            left = end - time.monotonic()
            if left <= 0.0 or not select.select([udp], [], [], left)[0]:
                return None
            continue
        except ConnectionRefusedError:  # a peer of an earlier datagram is gone
            continue
        if is_welcome(sender):
            return datagram
        if time.monotonic() >= end:
            return None


@dataclass
class Session:
    """A session: messages out and in.

    Attributes:
        link: where datagrams go to and come from.
        clock: time, s since 1970.
        refused: number of datagrams that were no envelope.
    """

    link: Link
    clock: Clock = time.time
    refused: int = 0

    @classmethod
    def join(cls, cid: int, ttl: int = 0) -> Session:
        """Join the session with a number; see `MulticastLink`."""
        return cls(MulticastLink(cid, ttl))

    def send(
        self, message: str, fields: Mapping[str, float], sender_stamp: int = 0, sampled: float | None = None
    ) -> None:
        """Send a message; `sampled` is the time of the measurement, s since 1970, by default now."""
        now = time_of(self.clock())
        at = now if sampled is None else time_of(sampled)
        self.link.send(encode(message, fields, sender_stamp=sender_stamp, sent=now, sampled=at))

    def receive(self, timeout_s: float) -> Envelope | None:
        """Return the next known message, or None after a time, s; what is no envelope is counted and dropped."""
        end = time.monotonic() + timeout_s
        while True:
            datagram = self.link.receive(max(end - time.monotonic(), 0.0))
            if datagram is None:
                return None
            received = time_of(self.clock())
            found = decode(datagram)
            self.refused += not found
            if found and found[0].message in MESSAGES:
                return found[0]._replace(received=received)
            if time.monotonic() >= end:
                return None

    def close(self) -> None:
        """Close the link."""
        self.link.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
