"""Ask a running `sonar-gym serve` for readings, with the standard library alone: sonar_client.py [HOST PORT]."""

from __future__ import annotations

import socket
import struct
import sys


def ask(server: socket.socket, pings: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Return (range in m, status, credence) of pings (distance, bearing, incidence, reflectance, time, sensor)."""
    body = struct.pack("<4sII", b"PING", len(pings), 0) + b"".join(struct.pack("<6d", *ping) for ping in pings)
    server.sendall(struct.pack("<I", len(body)) + body)
    answer = receive(server, struct.unpack("<I", receive(server, 4))[0])
    if answer[:4] != b"READ":
        raise ValueError(answer[4:].decode())
    return list(struct.iter_unpack("<3d", answer[8:]))


def receive(server: socket.socket, size: int) -> bytes:
    """Return exactly so many bytes."""
    data = b""
    while len(data) < size:
        part = server.recv(size - len(data))
        if not part:
            raise ConnectionError("the server closed the connection")
        data += part
    return data


if __name__ == "__main__":
    host, port = sys.argv[1:] or ("127.0.0.1", "7715")
    pings = [(0.5 + 0.25 * k, 0.0, 0.0, 0.9, 0.0, k) for k in range(8)]
    with socket.create_connection((host, int(port)), timeout=10) as server:
        for ping, (distance, status, credence) in zip(pings, ask(server, pings), strict=True):
            print(f"true {ping[0]:.2f} m, read {distance:.2f} m, status {status:.0f}, credence {credence:.2f}")
