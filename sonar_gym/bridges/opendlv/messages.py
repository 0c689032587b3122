"""The messages of the OpenDLV standard message set that the bridge speaks, and their encoding.

A datagram is 0x0D 0xA4, the length of the envelope (24 bits, least significant byte first) and the envelope. Envelope,
time stamps and messages are Protocol Buffers (proto2) in which every field is written, zeros too; signed integers are
zigzag-encoded. Ids and fields: opendlv.standard-message-set 0.9.10, <https://github.com/chalmers-revere>.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from acquisition import SettingError
from acquisition.limits import Limit, check_choice, check_number, is_list, shown

Time = tuple[int, int]  # seconds and microseconds since 1970, UTC
HEADER = b"\x0d\xa4"
HEADER_SIZE = 5  # with the length
MAX_DATAGRAM = 65_507  # bytes of a UDP datagram over IPv4
NO_TIME: Time = (0, 0)
INT32, UINT32 = (-(2**31), 2**31 - 1), (0, 2**32 - 1)
SIGNED, STAMPS = Limit(*INT32), Limit(*UINT32)

READING = "opendlv.proxy.DistanceReading"
VOLTAGE = "opendlv.proxy.VoltageReading"
PEDAL = "opendlv.proxy.PedalPositionRequest"
STEERING = "opendlv.proxy.GroundSteeringRequest"
FRAME = "opendlv.sim.Frame"
KINEMATICS = "opendlv.sim.KinematicState"
# message -> id and fields, all of type float and numbered from 1
MESSAGES: Mapping[str, tuple[int, tuple[str, ...]]] = {
    READING: (1039, ("distance",)),  # m
    VOLTAGE: (1037, ("voltage",)),  # V
    PEDAL: (1086, ("position",)),  # 1; below 0 is reverse
    STEERING: (1090, ("groundSteering",)),  # rad, left positive
    FRAME: (1001, ("x", "y", "z", "roll", "pitch", "yaw")),  # m and rad, in the world
    KINEMATICS: (1002, ("vx", "vy", "vz", "rollRate", "pitchRate", "yawRate")),  # m/s and rad/s, in the car's axes
}
NAMES = {number: name for name, (number, _) in MESSAGES.items()}

_Field = descriptor_pb2.FieldDescriptorProto
_STAMP = "Stamp"
_ENVELOPE = (
    ("dataType", _Field.TYPE_SINT32),
    ("serializedData", _Field.TYPE_BYTES),
    ("sent", _Field.TYPE_MESSAGE),
    ("received", _Field.TYPE_MESSAGE),
    ("sampleTimeStamp", _Field.TYPE_MESSAGE),
    ("senderStamp", _Field.TYPE_UINT32),
)
_TIMES = (("seconds", _Field.TYPE_SINT32), ("microseconds", _Field.TYPE_SINT32))


@cache
def _classes() -> dict[str, Any]:
    """Return the classes of all messages, built at run time: the messages are few and flat."""
    file = descriptor_pb2.FileDescriptorProto(name="sonar_gym/opendlv.proto", package="sonar_gym", syntax="proto2")
    floats = {name: [(field, _Field.TYPE_FLOAT) for field in fields] for name, (_, fields) in MESSAGES.items()}
    for name, fields in {_STAMP: _TIMES, "Envelope": _ENVELOPE, **floats}.items():
        message = file.message_type.add(name=_class_name(name))
        for number, (field, kind) in enumerate(fields, 1):
            entry = message.field.add(name=field, number=number, type=kind, label=_Field.LABEL_OPTIONAL)
            if kind == _Field.TYPE_MESSAGE:
                entry.type_name = f".sonar_gym.{_STAMP}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    of = pool.FindMessageTypeByName
    return {m.name: message_factory.GetMessageClass(of(f"sonar_gym.{m.name}")) for m in file.message_type}


def _class_name(name: str) -> str:
    return name.replace(".", "_")


def encode(
    message: str,
    fields: Mapping[str, float],
    *,
    sender_stamp: int = 0,
    sent: Time,
    received: Time = NO_TIME,
    sampled: Time,
) -> bytes:
    """Return a message as a datagram, byte for byte as libcluon writes it.

    Args:
        message: full name, one of `MESSAGES`.
        fields: values by name; a missing field is 0. Values are rounded to 32 bits; NaN and infinities are sent.
        sender_stamp: number of the sensor, actuator or frame.
        sent: time at which the datagram is handed to UDP, s and us since 1970.
        received: time of receipt, s and us; a sender leaves it at 0, a `.rec` file holds it.
        sampled: time of the measurement, s and us.

    Raises:
        SettingError: the message or a field is unknown, or a number does not fit its field.

    >>> encode(READING, {"distance": 1.0}, sender_stamp=2, sent=(1, 2), sampled=(1, 0)).hex()
    '0da41e0000089e1012050d0000803f1a04080210042204080010002a04080210003002'
    """
    classes = _classes()
    for name, stamp in {"sent": sent, "received": received, "sampled": sampled}.items():
        _check_time(name, stamp)
    check_number("OpenDLV sender_stamp", sender_stamp, STAMPS, whole=True)
    envelope = classes["Envelope"](
        dataType=_known(message, fields),
        serializedData=_payload(message, fields),
        sent=_stamp(sent),
        received=_stamp(received),
        sampleTimeStamp=_stamp(sampled),
        senderStamp=int(sender_stamp),
    ).SerializeToString(deterministic=True)
    return HEADER + len(envelope).to_bytes(3, "little") + envelope


def _stamp(time: Time) -> Any:
    return _classes()[_STAMP](seconds=int(time[0]), microseconds=int(time[1]))


def _payload(message: str, fields: Mapping[str, float]) -> bytes:
    values = {name: _single(f"{message} {name}", fields.get(name, 0.0)) for name in MESSAGES[message][1]}
    data: bytes = _classes()[_class_name(message)](**values).SerializeToString(deterministic=True)
    return data


def _single(name: str, value: Any) -> float:
    """Return a value rounded to 32 bits; beyond the largest float, as in C++, infinity."""
    try:
        with np.errstate(over="ignore"):
            return float(np.float32(value))
    except (OverflowError, TypeError, ValueError):
        raise SettingError(f"{name}: expected a number, got {shown(value)}") from None


def _known(message: str, fields: Mapping[str, float]) -> int:
    """Return the id of a message whose fields are all known."""
    check_choice("OpenDLV message", message, tuple(MESSAGES))
    number, names = MESSAGES[message]
    if not isinstance(fields, Mapping):
        raise SettingError(f"{message} fields: expected a mapping of {', '.join(names)}, got {shown(fields)}")
    for name in fields:
        check_choice(f"{message} field", name, names)
    return number


def _check_time(name: str, time: Any) -> None:
    if not (is_list(time) and len(time) == len(_TIMES)):
        raise SettingError(f"OpenDLV {name}: expected seconds and microseconds, got {shown(time)}")
    for (part, _), value in zip(_TIMES, time, strict=True):
        check_number(f"OpenDLV {name} {part}", value, SIGNED, whole=True)
