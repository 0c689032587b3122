"""Every altered byte and every moved line of a ledger is noticed; only one process writes it."""

import errno
import json
import lzma
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from training.proof.chain import Chain, ProofError, load, parse
from training.proof.verify import order_problems

N_MUTATIONS = 1000


def mutated(data, rng):
    """Return the bytes of a ledger with one random change."""
    lines = data.split(b"\n")[:-1]
    k, other = rng.integers(len(lines), size=2)
    place = int(rng.integers(len(data)))
    kind = rng.integers(8)
    if kind == 0:
        lines = [*lines[:k], *lines[k + 1 :]]
    elif kind == 1:
        lines.insert(int(other), lines[k])
    elif kind == 2:
        lines[k], lines[other] = lines[other], lines[k]
    elif kind == 3:
        lines = [lines[i] for i in rng.permutation(len(lines))]
    elif kind == 4:
        return data[:place]
    elif kind == 5:
        return data[:place] + bytes([rng.integers(256)]) + data[place:]
    elif kind == 6:
        return data[:place] + data[place + 1 :]
    else:
        return data[:place] + bytes([rng.integers(256)]) + data[place + 1 :]
    return b"".join(line + b"\n" for line in lines)


def accepted(data):
    try:
        return not list(order_problems(parse(data, "ledger")))
    except ProofError:
        return False


def test_no_random_mutation_of_a_ledger_is_accepted(finished):
    _, data, _ = finished
    assert accepted(data)
    rng = np.random.default_rng(1)
    changed = [each for _ in range(N_MUTATIONS) if (each := mutated(data, rng)) != data]
    assert len(changed) > 0.9 * N_MUTATIONS
    assert not [each for each in changed if accepted(each)]


@pytest.mark.parametrize("rest", [b"notes", b"[", b"\x1f\x8b"])
def test_what_is_no_beginning_of_a_line_is_not_cut_off(finished, tmp_path, rest):
    path = tmp_path / "ledger.jsonl"
    for data in (rest, finished[1] + rest):
        path.write_bytes(data)
        with pytest.raises(ProofError, match="is no ledger"):
            Chain.open(path)
        assert path.read_bytes() == data


@pytest.mark.parametrize("text", ['{"event": "a"}', "[]", "1", "null", "", "{", '{"event":"deck"}', "\xff", "[" * 5000])
def test_what_is_no_line_is_refused(text):
    with pytest.raises(ProofError, match="line 1"):
        parse(text.encode("latin-1") + b"\n", "ledger")


numbers = st.floats(allow_nan=False) | st.integers()
content = st.dictionaries(
    st.text(max_size=5).map(lambda s: "x" + s), st.none() | numbers | st.text() | st.lists(numbers)
)


@settings(max_examples=30, deadline=None)
@given(st.lists(content, min_size=1, max_size=5))
def test_what_was_written_is_read(tmp_path_factory, contents):
    path = tmp_path_factory.mktemp("chain") / "ledger.jsonl"
    chain = Chain.open(path)
    for each in contents:
        chain.append(("event", each))
    chain.close()
    assert load(path) == chain.lines
    assert [{k: line[k] for k in each} for line, each in zip(chain.lines, contents, strict=True)] == contents
    packed = path.with_suffix(".xz")
    packed.write_bytes(lzma.compress(path.read_bytes()))
    assert load(packed) == chain.lines


def test_a_line_that_is_too_long_is_not_parsed(tmp_path, monkeypatch):
    path = tmp_path / "ledger.jsonl"
    chain = Chain.open(path)
    chain.append(("one", {"n": "x" * 100}))
    chain.close()
    monkeypatch.setattr("training.proof.chain.MAX_LINE", 100)
    with pytest.raises(ProofError, match="line 1: it was changed"):
        load(path)


def test_a_line_that_was_cut_short_is_removed_and_others_are_kept(tmp_path):
    path = tmp_path / "ledger.jsonl"
    chain = Chain.open(path)
    chain.append(("one", {"n": 1}), ("two", {"n": 2}))
    chain.close()
    whole = path.read_bytes()
    path.write_bytes(whole[:-7])
    again = Chain.open(path)
    assert [line["event"] for line in again.lines] == ["one"]
    again.append(("two", {"n": 2}))
    again.close()
    assert path.read_bytes() == whole


def test_a_write_that_fails_half_way_leaves_the_ledger_as_it_was(tmp_path, monkeypatch):
    chain, write = Chain.open(tmp_path / "ledger.jsonl"), os.write
    chain.append(("one", {"n": 1}))

    def full(handle, data):
        if len(data) < 20:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(handle, data[:-10])

    with monkeypatch.context() as patch:
        patch.setattr("training.proof.chain.os.write", full)
        with pytest.raises(OSError, match="No space"):
            chain.append(("two", {"n": 2}), ("three", {"n": 3}))
    chain.append(("two", {"n": 2}))
    chain.close()
    assert [line["event"] for line in load(chain.path)] == ["one", "two"]
    assert load(chain.path) == chain.lines


def test_two_processes_cannot_write_one_ledger(tmp_path):
    first = Chain.open(tmp_path / "ledger.jsonl")
    with pytest.raises(ProofError, match="another process"):
        Chain.open(tmp_path / "ledger.jsonl")
    first.close()


def test_a_ledger_that_was_changed_is_not_continued(finished, tmp_path):
    _, data, _ = finished
    path = tmp_path / "ledger.jsonl"
    first = json.loads(data.split(b"\n")[0])
    path.write_bytes(data.replace(first["commit"].encode(), b"other", 1))
    with pytest.raises(ProofError, match="line 1"):
        Chain.open(path)
