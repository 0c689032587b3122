"""Sessions: multicast in a network namespace of the test's own, and plain loopback UDP."""

import socket
import time

import pytest

from acquisition import SettingError
from sonar_gym.bridges.opendlv import encode
from sonar_gym.bridges.opendlv.messages import FRAME, READING
from sonar_gym.bridges.opendlv.session import MulticastLink, seconds_of, time_of

GROUP = """
import socket, time
from sonar_gym.bridges.opendlv.messages import READING
from sonar_gym.bridges.opendlv.session import Session
one, two, other = Session.join(111), Session.join(111), Session.join(112)
one.send(READING, {"distance": 1.5}, 7, sampled=12.25)
found = two.receive(5.0)
print(found.fields, found.sender_stamp, found.sampled, abs(found.received[0] - time.time()) < 5)
print("own:", one.receive(0.2), "other session:", other.receive(0.2))
stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for data in (b"", b"noise", b"\\x0d\\xa4\\xff\\xff\\xff"):
    stranger.sendto(data, ("225.0.0.111", 12175))
print("noise:", two.receive(0.3), two.refused)
"""


def test_sessions_of_one_number_hear_each_other_and_not_themselves(in_namespace):
    done = in_namespace(GROUP)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "{'distance': 1.5} 7 (12, 250000) True",
        "own: None other session: None",
        "noise: None 3",
    ]


def test_a_machine_without_a_route_is_told_how_to_make_one(in_namespace):
    done = in_namespace("from sonar_gym.bridges.opendlv.session import Session; Session.join(111)", routed=False)
    assert "cannot join 225.0.0.111" in done.stderr
    assert "ip route add 225.0.0.0/24 dev lo" in done.stderr


@pytest.mark.parametrize(("cid", "ttl", "text"), [(0, 0, "cid"), (255, 0, "cid"), (111, 256, "ttl")])
def test_numbers_outside_their_limits_are_named(cid, ttl, text):
    with pytest.raises(SettingError, match=f"{text}: expected a whole number from"):
        MulticastLink(cid, ttl)


def test_all_of_10_000_datagrams_arrive_right(pair):
    one, two = pair
    for begin in range(0, 10_000, 50):  # as many as the system's buffer surely holds
        for k in range(begin, begin + 50):
            one.send(READING, {"distance": k / 64}, k, sampled=k / 64)
        for k in range(begin, begin + 50):
            envelope = two.receive(5.0)
            assert (envelope.sender_stamp, envelope.fields["distance"]) == (k, k / 64)
            assert seconds_of(envelope.sampled) == k / 64


def test_strangers_and_noise_are_dropped(pair):
    one, two = pair
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.send(FRAME, {"x": 1.0})
    two.receive(5.0)
    stranger.sendto(encode(FRAME, {"x": 2.0}, sent=(1, 0), sampled=(1, 0)), two.link.address)
    one.link.send(b"noise")
    assert two.receive(0.2) is None
    assert two.refused == 1
    stranger.close()


def test_a_flood_does_not_extend_the_time_to_wait(pair):
    one, two = pair
    begin = time.monotonic()
    while time.monotonic() - begin < 0.3:
        one.link.send(b"noise")
        two.receive(0.01)
    for _ in range(200):
        one.link.send(b"noise")
    begin = time.monotonic()
    two.receive(0.05)
    assert time.monotonic() - begin < 0.5


def test_a_time_is_split_and_joined():
    assert time_of(-0.25) == (-1, 750_000)
    assert time_of(1.9999999) == (2, 0)
    assert seconds_of(time_of(1_700_000_000.123456)) == pytest.approx(1_700_000_000.123456, abs=5e-7)
