"""OpenDLV: messages on the wire, sessions, a sonar and a car in them, and `.rec` files.

messages: the messages and their encoding. wire: decoding, as libcluon decodes. session: UDP multicast sessions.
walls: map files and the sonars on them. sonar: this project's sonar on a car of theirs. car: the parking car in a
session of theirs. agent: the trained agent at the wheel of a car in a session. rec: `.rec` files and recordings.
"""

from sonar_gym.bridges.opendlv.messages import encode
from sonar_gym.bridges.opendlv.wire import Envelope, decode

__all__ = ["Envelope", "decode", "encode"]
