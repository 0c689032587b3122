"""Datagrams of OpenDLV: written as libcluon writes them, read as it reads them."""

import json
import math
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import SettingError
from sonar_gym.bridges.opendlv import decode, encode
from sonar_gym.bridges.opendlv.messages import HEADER, INT32, MESSAGES, READING, UINT32

NOW = {"sent": (1_650_000_000, 5), "sampled": (1_650_000_000, 4)}
times = st.tuples(st.integers(*INT32), st.integers(*INT32))
messages = st.sampled_from(sorted(MESSAGES)).flatmap(
    lambda name: st.tuples(
        st.just(name), st.fixed_dictionaries({f: st.floats(width=32, allow_nan=True) for f in MESSAGES[name][1]})
    )
)


def varint(value):
    out = b""
    while value > 0x7F:
        out, value = out + bytes([value & 0x7F | 0x80]), value >> 7
    return out + bytes([value])


def zigzag(value):
    return varint(((value << 1) ^ (value >> 31)) & 0xFFFFFFFF)


def field(number, kind, content):
    return varint(number << 3 | kind) + (varint(len(content)) + content if kind == 2 else content)


def stamp(seconds, microseconds):
    return field(1, 0, zigzag(seconds)) + field(2, 0, zigzag(microseconds))


def datagram(*fields, length=None):
    body = b"".join(fields)
    return HEADER + (len(body) if length is None else length).to_bytes(3, "little") + body


PARTS = {
    "type": field(1, 0, zigzag(1039)),
    "data": field(2, 2, field(1, 5, struct.pack("<f", 1.5))),
    "sent": field(3, 2, stamp(10, 20)),
    "received": field(4, 2, stamp(0, 0)),
    "sampled": field(5, 2, stamp(-1, -2)),
    "stamp": field(6, 0, varint(3)),
}


def same(a, b):
    return struct.pack("<f", a) == struct.pack("<f", b) or (math.isnan(a) and math.isnan(b))


def test_reference_datagrams_byte_for_byte_in_both_directions(opendlv_vectors):
    cases = json.loads((opendlv_vectors / "vectors.json").read_text())["cases"]
    assert len(cases) > 20
    for case in cases:
        sent, received, sampled = (tuple(case[k].values()) for k in ("sent", "received", "sampled"))
        fields = {name: float(value) for name, value in case["fields"].items()}
        given_ = {"sender_stamp": case["sender_stamp"], "sent": sent, "received": received, "sampled": sampled}
        assert encode(case["message"], fields, **given_).hex() == case["bytes_hex"], case["name"]
        (envelope,) = decode(bytes.fromhex(case["bytes_hex"]))
        assert envelope.message == case["message"]
        assert (envelope.sender_stamp, envelope.sent, envelope.received, envelope.sampled) == tuple(given_.values())
        for name, bits in case["fields_f32"].items():
            assert same(envelope.fields[name], struct.unpack(">f", bytes.fromhex(bits))[0])


def test_the_encoder_writes_what_the_format_says():
    given_ = {"sender_stamp": 3, "sent": (10, 20), "sampled": (-1, -2)}
    assert encode(READING, {"distance": 1.5}, **given_) == datagram(*PARTS.values())


@given(messages, st.integers(*UINT32), times, times, times)
def test_what_is_encoded_is_decoded(message, sender, sent, received, sampled):
    name, fields = message
    (envelope,) = decode(encode(name, fields, sender_stamp=sender, sent=sent, received=received, sampled=sampled))
    assert (envelope.message, envelope.sender_stamp) == (name, sender)
    assert (envelope.sent, envelope.received, envelope.sampled) == (sent, received, sampled)
    assert all(same(envelope.fields[k], value) for k, value in fields.items())


@given(st.permutations(sorted(PARTS)), st.integers(7, 2**29 - 1))
def test_fields_come_in_any_order_and_unknown_ones_are_skipped(order, unknown):
    more = [field(unknown, 2, b"abc"), field(unknown, 0, varint(2**40)), field(unknown, 1, bytes(8))]
    (envelope,) = decode(datagram(*more, *(PARTS[name] for name in order)))
    assert (envelope.fields, envelope.sender_stamp) == ({"distance": 1.5}, 3)
    assert (envelope.sent, envelope.sampled) == ((10, 20), (-1, -2))


@given(st.sets(st.sampled_from(sorted(PARTS))))
def test_missing_fields_are_zero(left_out):
    (envelope,) = decode(datagram(*(part for name, part in PARTS.items() if name not in left_out)))
    assert envelope.message == ("0" if "type" in left_out else READING)
    assert envelope.sender_stamp == (0 if "stamp" in left_out else 3)
    assert envelope.sent == ((0, 0) if "sent" in left_out else (10, 20))
    if envelope.message == READING:
        assert envelope.fields["distance"] == (0.0 if "data" in left_out else 1.5)


@pytest.mark.parametrize(
    ("data", "accepted"),
    [
        (b"", False),
        (HEADER, False),
        (datagram(*PARTS.values())[:-1], False),  # shorter than its length
        (b"\x0d\xa5" + datagram(*PARTS.values())[2:], False),
        (b"\x0e\xa4" + datagram(*PARTS.values())[2:], False),
        (datagram(*PARTS.values(), length=2**24 - 1), False),
        (datagram(field(2, 2, b"")[:-1] + varint(100) + b"abc"), False),  # a length that exceeds the envelope
        (datagram(), True),
        (datagram(*PARTS.values()) + b"more", True),
    ],
)
def test_datagrams_are_refused_by_header_and_length_alone(data, accepted):
    assert len(decode(data)) == accepted


def test_only_the_first_envelope_of_a_datagram_counts():
    first, second = (encode(READING, {"distance": d}, **NOW) for d in (1.0, 2.0))
    assert [envelope.fields["distance"] for envelope in decode(first + second)] == [1.0]


def test_an_unknown_message_is_an_envelope_without_fields():
    (envelope,) = decode(datagram(field(1, 0, zigzag(19)), field(2, 2, b"\x08\x01")))
    assert (envelope.message, envelope.fields) == ("19", {})


def test_repeated_fields_are_read_as_libcluon_reads_them():
    again = [field(6, 0, varint(9)), field(3, 2, field(1, 0, zigzag(77)))]
    (envelope,) = decode(datagram(*PARTS.values(), *again))
    assert (envelope.sender_stamp, envelope.sent) == (9, (77, 20))  # of an envelope the last, part by part
    (envelope,) = decode(datagram(field(5, 2, stamp(1, 2) + field(1, 0, zigzag(-7)) + field(2, 5, bytes(4)))))
    assert envelope.sampled == (-7, -7)  # of a time stamp too; a part of another type repeats the last number
    data = field(2, 2, field(1, 5, struct.pack("<f", 1.0)) + field(1, 5, struct.pack("<f", 2.0)))
    (envelope,) = decode(datagram(PARTS["type"], data))
    assert envelope.fields["distance"] == 1.0  # of a message the first


def test_content_of_another_type_is_zero_and_content_cut_short_is_filled_up():
    (envelope,) = decode(datagram(PARTS["type"], field(2, 2, field(1, 0, varint(5)))))
    assert envelope.fields["distance"] == 0.0
    (envelope,) = decode(datagram(PARTS["type"], field(2, 2, field(1, 5, b"\0\0\x80"))))
    assert envelope.fields["distance"] == struct.unpack("<f", b"\0\0\x80\0")[0]
    (envelope,) = decode(datagram(PARTS["type"], field(6, 0, b"\x85")))
    assert envelope.sender_stamp == 0x85 & 0x7F | 0x7F << 7  # the end of the stream reads as -1
    (envelope,) = decode(datagram(field(6, 0, b"\x85" + 9 * b"\x80" + b"\x03")))
    assert envelope.sender_stamp == 5 | 3 << 70 - 64  # more than 64 bits begin again at the lowest


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"message": "opendlv.sim.Frames"}, "did you mean opendlv.sim.Frame"),
        ({"message": []}, "OpenDLV message: expected one of"),
        ({"fields": {"range": 1.0}}, "DistanceReading field: expected one of distance, got 'range'"),
        ({"fields": [1.0]}, "expected a mapping of distance"),
        ({"fields": {"distance": "far"}}, "distance: expected a number, got 'far'"),
        ({"sender_stamp": -1}, "sender_stamp: expected a whole number from 0 to 4294967295, got -1"),
        ({"sent": (2**31, 0)}, "sent seconds: expected a whole number from"),
        ({"sampled": (0, -(2**31) - 1)}, "sampled microseconds: expected"),
        ({"sampled": 5.0}, "sampled: expected seconds and microseconds, got 5"),
    ],
)
def test_what_cannot_be_encoded_is_named(change, text):
    settings = {"message": READING, "fields": {"distance": 1.0}, **NOW, **change}
    with pytest.raises(SettingError, match=text):
        encode(settings.pop("message"), settings.pop("fields"), **settings)


def test_values_are_rounded_to_32_bits_and_too_large_ones_are_infinite():
    (envelope,) = decode(encode(READING, {"distance": 1e39}, **NOW))
    assert envelope.fields["distance"] == math.inf
    (envelope,) = decode(encode(READING, {"distance": 0.1}, **NOW))
    assert envelope.fields["distance"] == float(np.float32(0.1))


@given(st.binary(max_size=200), st.booleans())
def test_no_datagram_raises(data, framed):
    assert len(decode(datagram(data) if framed else data)) <= 1


def fuzz(count, rng):
    """Decode random datagrams: noise, framed noise, and envelopes with some bytes changed."""
    whole = np.frombuffer(encode(READING, {"distance": 1.0}, **NOW), np.uint8)
    for k in range(count):
        data = rng.integers(0, 256, rng.integers(0, 120), dtype=np.uint8).tobytes()
        if k % 3 == 1:
            data = datagram(data)
        elif k % 3 == 2:
            changed = whole.copy()
            changed[rng.integers(0, len(whole), 3)] = rng.integers(0, 256, 3)
            data = changed.tobytes()
        decode(data)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_100_000_random_datagrams_raise_nothing_and_leave_no_memory():
    rng = np.random.default_rng(1)
    fuzz(1000, rng)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    fuzz(100_000, rng)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert after - before < 20_000
