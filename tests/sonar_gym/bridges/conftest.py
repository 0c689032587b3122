"""Pairs of connected sessions."""

import shutil
import subprocess
import sys

import pytest

from sonar_gym.bridges.opendlv.session import Session, _receive, _send, _udp

ROUTED = "ip link set lo up && ip route add 225.0.0.0/24 dev lo && "


class LoopbackLink:
    """Plain UDP to another link of this machine, for machines without multicast."""

    def __init__(self):
        self._socket = _udp()
        self._socket.bind(("127.0.0.1", 0))
        self.address = self._socket.getsockname()

    def send(self, datagram):
        _send(self._socket, datagram)

    def receive(self, timeout_s):
        return _receive(self._socket, timeout_s, lambda sender: sender == self.peer)

    def connect(self, peer):
        self.peer = peer
        self._socket.connect(peer)

    def close(self):
        self._socket.close()


@pytest.fixture
def pair():
    """Two sessions that hear each other over loopback UDP."""
    links = [LoopbackLink(), LoopbackLink()]
    for own, other in (links, links[::-1]):
        own.connect(other.address)
    sessions = [Session(link) for link in links]
    yield sessions
    for session in sessions:
        session.close()


@pytest.fixture(scope="session")
def in_namespace():
    """Run Python code in a network namespace of its own, with or without a route for multicast."""
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        pytest.skip("needs unshare and ip")
    if subprocess.run(["unshare", "-rn", "true"], capture_output=True).returncode:
        pytest.skip("this machine allows no network namespaces")

    def run(code, routed=True):
        shell = ROUTED if routed else ""
        command = ["unshare", "-rn", "sh", "-c", f'{shell}exec "$0" -c "$1"', sys.executable, code]
        return subprocess.run(command, capture_output=True, text=True, timeout=120)

    return run
