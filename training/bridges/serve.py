"""A sonar that other programs ask over TCP: pings in, readings with credence out (docs/how-to/simulators.md)."""

from __future__ import annotations

import asyncio
import gc
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from threadpoolctl import threadpool_limits

from acquisition.limits import Limit, Seed
from sonar_gym.bridges.server.server import PORT, ServerSettings, SonarServer


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym serve`."""

    model: Annotated[Path, tyro.conf.Positional] = Path("srf08-mlp")
    """Sonar: a name (ideal, gaussian, srf08-mlp, ...) or the folder of a saved model."""
    host: str = "127.0.0.1"
    """Address to bind. By default only programs on this machine can connect."""
    port: Annotated[int, Limit(0, 65_535)] = PORT
    """TCP port; 0 for any free one."""
    max_range: Annotated[float, Limit(0.05, 100.0, "m")] = 6.0
    """Maximum range, m; an echo beyond it is no echo."""
    seed: Seed = 0
    """Seed of every client's readings, unless it sends its own."""
    max_clients: Annotated[int, Limit(1, 10_000)] = 64
    """Number of clients at a time."""


def main(args: Args) -> None:
    """Serve until interrupted."""
    settings = ServerSettings(args.host, args.port, args.max_range, args.seed, args.max_clients)
    server = SonarServer(args.model, settings)

    def ready() -> None:
        gc.freeze()  # what the start has made stays, so that no search for garbage in it delays an answer
        print(f"{args.model} at tcp://{server.address[0]}:{server.address[1]}; stop with Ctrl-C", flush=True)

    with threadpool_limits(1):  # a batch is too small for several threads, which wait for each other
        asyncio.run(server.run(ready))
