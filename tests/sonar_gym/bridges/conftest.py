"""Pairs of connected sessions."""

import shutil
import subprocess
import sys

import pytest

from sonar_gym.bridges.opendlv.session import Session, UnicastLink

ROUTED = "ip link set lo up && ip route add 225.0.0.0/24 dev lo && "


@pytest.fixture
def pair():
    """Two sessions that hear each other over loopback UDP."""
    links = [UnicastLink(("127.0.0.1", 0), []) for _ in range(2)]
    for own, other in (links, links[::-1]):
        own.peers = [other.address]
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
