"""The server: answers batches of pings over TCP, each client with sonars of its own.

A client that hangs, floods or vanishes costs the others nothing: a message that does not arrive whole in time, or whose
answer is not taken in time, ends its connection. No code is loaded from a message; see `protocol`.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated

from acquisition import DeviceError, Ping, SettingError, SonarError
from acquisition.arguments import checked
from acquisition.limits import SEEDS, Limit, PositiveMetres, check_settings
from sonar_gym.bridges.server import protocol
from sonar_gym.bridges.server.sensors import Sensors
from sonar_gym.sensing.sonar import SonarChoice, resolve

PORT = 7715
Wait = Annotated[float, Limit(0.0, 1e7, "s", open_low=True)]
LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class ServerSettings:
    """How the server works.

    Attributes:
        host: address to bind; by default only this machine can connect.
        port: TCP port; 0 for any free one.
        max_range: maximum range of the sonars, m.
        seed: of the random numbers; every client gets those of the same seed, unless it sends its own.
        max_clients: number of clients at a time.
        patience_s: time in which a message must arrive whole, and its answer be taken, s.
        idle_s: time without a message after which a connection ends, s.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, Limit(0, 65_535)] = PORT
    max_range: PositiveMetres = 6.0
    seed: Annotated[int, SEEDS] = 0
    max_clients: Annotated[int, Limit(1, 65_536)] = 64
    patience_s: Wait = 10.0
    idle_s: Wait = 3600.0

    def __post_init__(self) -> None:
        """Raise SettingError for values outside their limits."""
        check_settings(self)
        if not self.host:  # which asyncio would take for all addresses
            raise SettingError("ServerSettings.host: expected an address, got ''; 0.0.0.0 stands for all of them")


class SonarServer:
    """A server with one model.

    Args:
        model: name, path or model.
        settings: how it works.

    Attributes:
        address: host and port, once it runs.
        clients: number of clients.
    """

    @checked
    def __init__(self, model: SonarChoice, settings: ServerSettings | None = None) -> None:
        self.settings = settings or ServerSettings()
        self._model = resolve(model)
        self.address = (self.settings.host, self.settings.port)
        self.clients = 0
        # tabulates the credence and compiles the law before the first client waits for them
        Sensors(self._model, self.settings.max_range, 0).answer(Ping.of(1.0))

    async def run(self, ready: Callable[[], object] | None = None) -> None:
        """Serve until cancelled; `ready` is called once clients can connect.

        Raises:
            DeviceError: the address cannot be bound.
        """
        host, port = self.settings.host, self.settings.port
        try:
            server = await asyncio.start_server(self._serve, host, port)
        except (OSError, ValueError) as error:  # a name with a null character, or too long
            reason = getattr(error, "strerror", None) or error
            raise DeviceError(f"{host}:{port}: cannot be bound ({reason}); give another address or port") from None
        self.address = server.sockets[0].getsockname()[:2]
        async with server:
            if ready is not None:
                ready()
            await server.serve_forever()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = writer.get_extra_info("peername")
        self.clients += 1
        try:
            if self.clients > self.settings.max_clients:
                await self._send(
                    writer, _failure(f"{self.settings.max_clients} clients are connected; try again later")
                )
                return
            await self._converse(reader, writer)
        except (TimeoutError, asyncio.IncompleteReadError, ConnectionError) as error:
            LOG.info("client %s ended: %s", peer, type(error).__name__)
        finally:
            self.clients -= 1
            writer.transport.abort() if writer.transport.get_write_buffer_size() else writer.close()
            with suppress(ConnectionError, TimeoutError):
                await writer.wait_closed()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        sensors = Sensors(self._model, self.settings.max_range, self.settings.seed)
        while True:
            async with asyncio.timeout(self.settings.idle_s):
                head = await reader.readexactly(protocol.HEAD.size)
            (length,) = protocol.HEAD.unpack(head)
            if not len(protocol.PING) <= length <= protocol.MAX_BODY:
                await self._send(
                    writer,
                    _failure(f"a message has {length} bytes, expected 4 to {protocol.MAX_BODY}; see the protocol"),
                )
                return
            async with asyncio.timeout(self.settings.patience_s):
                message = await reader.readexactly(length)
            await self._send(writer, answer(sensors, message))

    async def _send(self, writer: asyncio.StreamWriter, message: bytes) -> None:
        writer.write(message)
        async with asyncio.timeout(self.settings.patience_s):
            await writer.drain()


def answer(sensors: Sensors, message: bytes) -> bytes:
    """Return the answer to a message without its length; what is wrong with the message is the answer, too."""
    kind, body = message[:4], message[4:]
    try:
        if kind == protocol.PING:
            return protocol.read_message(*sensors.answer(protocol.ping_of(body)))
        if kind == protocol.SEED and len(body) == protocol.SEED_BODY.size:
            sensors.restart(*protocol.SEED_BODY.unpack(body))
            return protocol.framed(protocol.READ, protocol.HEAD.pack(0))
    except SonarError as error:
        return _failure(str(error))
    return _failure(f"message {kind!r} with {len(body)} bytes: expected PING, or SEED with 8 bytes")


def _failure(text: str) -> bytes:
    return protocol.framed(protocol.FAIL, text.encode())
