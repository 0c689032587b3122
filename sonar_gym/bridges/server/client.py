"""A client of the sonar server, and of any simulator that answers the protocol."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated

import numpy as np

from acquisition import GarbledError, NoAnswerError, Ping, Reading, SettingError, UnpluggedError
from acquisition.arguments import checked
from acquisition.arrays import Floats
from acquisition.limits import Limit
from sonar_gym.bridges.server import protocol

BATCH = 1024  # pings in a message
# `pathlib` leaves one of the two slashes
ADDRESS = re.compile(r"tcp:/{1,2}(?P<host>\[[^\]]+\]|[^:/\[\]]+):(?P<port>\d{1,5})")


class SonarClient:
    """A connection to a server.

    Args:
        host: name or address.
        port: TCP port.
        timeout_s: time to wait for an answer, s.

    Raises:
        UnpluggedError: nobody answers at the address.
    """

    @checked
    def __init__(
        self,
        host: str,
        port: Annotated[int, Limit(0, 65_535)],
        timeout_s: Annotated[float, Limit(0.0, 86_400.0, "s", open_low=True)] = 10.0,
    ) -> None:
        self.name, self._timeout_s = f"tcp://{host}:{port}", timeout_s
        try:
            self._socket = socket.create_connection((host, port), float(timeout_s))
        except (OSError, UnicodeError) as error:  # a name that is none
            reason = getattr(error, "strerror", None) or error
            raise UnpluggedError(
                f"{self.name}: cannot connect ({reason}); is `sonar-gym serve` or your server running?"
            ) from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    @checked
    def seed(self, seed: Annotated[int, Limit(0, 2**64 - 1)]) -> None:
        """Begin anew: random numbers of a seed, 0 to 2^64 - 1, and sonars without memory."""
        self._exchange(protocol.framed(protocol.SEED, protocol.SEED_BODY.pack(seed)))

    @checked
    def ask(self, ping: Ping) -> tuple[Reading, Floats]:
        """Return the reading of each ping, and its credence given the reading, (n,); `run` numbers the sensors.

        Raises:
            SettingError: the server refused a value.
            NoAnswerError: no answer in time.
        """
        if not len(ping):
            return Reading.of([]), np.empty(0)
        parts = [self._ask(ping[k : k + BATCH]) for k in range(0, len(ping), BATCH)]
        columns = zip(*((reading.range, reading.status, credence) for reading, credence in parts), strict=True)
        range_, status, credence = map(np.concatenate, columns)
        return Reading(range_, status), credence

    def _ask(self, ping: Ping) -> tuple[Reading, Floats]:
        reading, credence = self._exchange(protocol.ping_message(ping))
        if len(reading) != len(ping):
            raise GarbledError(f"{self.name}: answered {len(reading)} of {len(ping)} pings; is it a sonar server?")
        return reading, credence

    def _exchange(self, message: bytes) -> tuple[Reading, Floats]:
        (length,) = protocol.HEAD.unpack(self._read(protocol.HEAD.size, message))
        if not 4 <= length <= protocol.MAX_BODY:
            raise GarbledError(f"{self.name}: announced {length} bytes; is it a sonar server?")
        answer = self._read(length)
        if answer[:4] == protocol.FAIL:
            raise SettingError(f"{self.name}: {answer[4:].decode('utf-8', 'replace')}")
        if answer[:4] != protocol.READ:
            raise GarbledError(f"{self.name}: answered {answer[:4]!r}, expected READ; is it a sonar server?")
        return protocol.reading_of(answer[4:])

    def _read(self, size: int, request: bytes = b"") -> bytes:
        """Send a request, if there is one, and return exactly so many bytes."""
        try:
            self._socket.sendall(request)
            return self._receive(size)
        except TimeoutError:
            raise NoAnswerError(f"{self.name}: no answer within {self._timeout_s:g} s") from None
        except ConnectionError as error:
            raise UnpluggedError(f"{self.name}: the connection ended ({error.strerror or error})") from None

    def _receive(self, size: int) -> bytes:
        parts, left = [], size
        while left:
            part = self._socket.recv(min(left, 65_536))
            if not part:
                raise ConnectionResetError("the server closed it")
            parts.append(part)
            left -= len(part)
        return b"".join(parts)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def __enter__(self) -> SonarClient:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


@checked
def address_of(text: str) -> tuple[str, int] | None:
    """Return host and port of `tcp://HOST:PORT`; None for any other text.

    >>> address_of("tcp://localhost:7715")
    ('localhost', 7715)
    >>> address_of("simulated.csv")
    """
    found = ADDRESS.fullmatch(text)
    return (found["host"].strip("[]"), int(found["port"])) if found else None


@checked
def simulator_at(host: str, port: int) -> Callable[[Ping, np.random.Generator], Reading]:
    """Return a function that asks a running server for the readings of pings, with random numbers of a seed.

    Its sensors are the uninterrupted runs of the pings.
    """

    def simulate(ping: Ping, rng: np.random.Generator) -> Reading:
        with SonarClient(host, port) as client:
            client.seed(int(rng.integers(2**63)))
            runs = np.unique(ping.run, return_inverse=True)[1]
            return client.ask(replace(ping, run=runs))[0]

    return simulate
