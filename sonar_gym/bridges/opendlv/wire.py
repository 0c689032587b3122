"""Decoding of datagrams as libcluon's `OD4Session` does it, which is more lenient than a Protocol Buffers runtime.

A datagram is refused if its two first bytes or its length do not fit; everything after the first envelope is ignored.
Inside an envelope nothing is refused: fields come in any order, unknown ones are skipped, missing ones are 0, a number
that the data cut short is filled up. The encoder therefore uses a Protocol Buffers runtime and the decoder cannot. Only
where libcluon reads memory behind its data (a length that exceeds them) the envelope is refused here.

Source: the behaviour of libcluon's `extractEnvelope`, `extractMessage` and `FromProtoVisitor`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from acquisition.arguments import checked
from sonar_gym.bridges.opendlv.messages import HEADER, HEADER_SIZE, MESSAGES, NAMES, NO_TIME, Time

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5  # wire types
BITS = 64
MASK32, MASK64 = 2**32 - 1, 2**64 - 1
TYPE, DATA, SENT, RECEIVED, SAMPLED, STAMP = range(1, 7)  # field numbers of an envelope
STAMPS = (SENT, RECEIVED, SAMPLED)


class Envelope(NamedTuple):
    """One message with its envelope.

    Attributes:
        message: full name, or the id as text where the bridge does not know it.
        fields: values by name; empty for an unknown message.
        sender_stamp: number of the sensor, actuator or frame.
        sent, received, sampled: seconds and microseconds since 1970, UTC; (0, 0) where not stated.
    """

    message: str
    fields: Mapping[str, float]
    sender_stamp: int
    sent: Time
    received: Time
    sampled: Time


class _Overrun(ValueError):
    """A length exceeds the data."""


class _Field(NamedTuple):
    """A field as read, with the decoder's last number and string: libcluon reads those for a field of another type."""

    number: int
    kind: int
    value: int
    text: bytes
    four: bytes


@checked
def decode(datagram: bytes) -> list[Envelope]:
    """Return the envelope of a datagram as a list: one, or none if libcluon refuses the datagram.

    >>> decode(b"hello")
    []
    """
    end = envelope_end(datagram)
    if end is None:
        return []
    try:
        return [_envelope(bytes(datagram[HEADER_SIZE:end]))]
    except _Overrun:
        return []


def envelope_end(data: bytes, at: int = 0) -> int | None:
    """Return the end of the envelope whose header is at an index, or None if header or length do not fit."""
    start = at + HEADER_SIZE
    if len(data) < start or bytes(data[at : at + 2]) != HEADER:
        return None
    end = start + int.from_bytes(data[at + 2 : start], "little")
    return end if end <= len(data) else None


def _envelope(data: bytes) -> Envelope:
    number, payload, stamp = 0, b"", 0
    times = dict.fromkeys(STAMPS, NO_TIME)
    for field in _read(data):
        if field.number == TYPE:
            number = _zigzag(field.value)
        elif field.number == DATA:
            payload = _text(field)
        elif field.number in times:
            times[field.number] = _time(_text(field), times[field.number])
        elif field.number == STAMP:
            stamp = field.value & MASK32
    name = NAMES.get(number, str(number))
    return Envelope(name, _fields(name, payload), stamp, times[SENT], times[RECEIVED], times[SAMPLED])


def _fields(name: str, payload: bytes) -> dict[str, float]:
    """Return the fields of a message: of a repeated field the first, of a field of another type 0."""
    if name not in MESSAGES:
        return {}
    names = MESSAGES[name][1]
    first: dict[int, _Field] = {}
    for field in _read(payload):
        first.setdefault(field.number, field)
    floats = {number: field.four for number, field in first.items() if field.kind == FIXED32}
    return {name: struct.unpack("<f", floats.get(number, bytes(4)))[0] for number, name in enumerate(names, 1)}


def _time(text: bytes, before: Time) -> Time:
    """Return a time stamp; parts that it lacks stay as in an earlier one of the same envelope."""
    given = {field.number: _zigzag(field.value) for field in _read(text)}  # of a repeated part the last
    return given.get(1, before[0]), given.get(2, before[1])


def _text(field: _Field) -> bytes:
    """Return the string of a field.

    Raises:
        _Overrun: its length exceeds the data.
    """
    if field.value > len(field.text):
        raise _Overrun
    return field.text[: field.value]


def _read(data: bytes) -> Iterator[_Field]:
    """Yield the fields of a message in their order."""
    at, value, text, four = 0, 0, b"", bytes(4)
    while at < len(data):
        key, at = _varint(data, at)
        kind, number = key & 7, (key >> 3) & MASK32
        if kind == VARINT:
            value, at = _varint(data, at)
        elif kind == FIXED64:
            at += 8
        elif kind == FIXED32:
            four = data[at : at + 4] + four[len(data[at : at + 4]) :]
            at += 4
        elif kind == BYTES:
            value, at = _varint(data, at)
            text, at = data[at : at + value], at + value  # where the length exceeds the data, `_text` raises
        else:
            continue  # the next byte is read as a key again
        yield _Field(number, kind, value, text, four)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return a number and the index behind it; seven ones stand for the byte behind the end, libcluon's end of file.

    Of more than ten bytes, the further ones begin again at the lowest bits, as the processor shifts by 64 bits at most.
    """
    value = shift = 0
    while at < len(data):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        shift = (shift + 7) % BITS
        if byte < 0x80:
            return value & MASK64, at
    return (value | 0x7F << shift) & MASK64, at


def _zigzag(value: int) -> int:
    """Return the signed number of the last 32 bits: 0, 1, 2, 3 are 0, -1, 1, -2."""
    low = value & MASK32
    return (low >> 1) ^ -(low & 1)
