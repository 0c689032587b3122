"""Answers open with their own key in their own place, and with no other."""

import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from training.proof.chain import ProofError
from training.proof.sealing import BLOCK, seal, unseal

ANSWER = {"family": "rig", "kind": "single", "seed": 2**127 + 1, "causes": [{"effect": "zero_offset", "size": 0.5}]}


@settings(max_examples=50, deadline=None)
@given(st.dictionaries(st.text(), st.integers() | st.text() | st.lists(st.integers())), st.text())
def test_an_answer_opens_as_it_was(answer, context):
    key = os.urandom(32)
    assert unseal(seal(answer, key, context), key.hex(), context) == answer


def test_length_tells_nothing():
    lengths = {len(seal({"fault": "x" * n}, os.urandom(32), "")["ciphertext"]) for n in (0, 1, 500, BLOCK - 20)}
    assert len(lengths) == 1


def test_equal_answers_are_sealed_differently():
    assert seal(ANSWER, os.urandom(32), "a")["ciphertext"] != seal(ANSWER, os.urandom(32), "a")["ciphertext"]


@pytest.mark.parametrize("name", ["ciphertext", "nonce", "key_sha256"])
def test_a_changed_seal_does_not_open(name):
    key = os.urandom(32)
    sealed = seal(ANSWER, key, "a")
    changed = {**sealed, name: ("1" if sealed[name][0] == "0" else "0") + sealed[name][1:]}
    with pytest.raises(ProofError):
        unseal(changed, key.hex(), "a")


def test_another_key_or_place_does_not_open():
    key = os.urandom(32)
    sealed = seal(ANSWER, key, "deck 1")
    with pytest.raises(ProofError, match="committed"):
        unseal(sealed, os.urandom(32).hex(), "deck 1")
    with pytest.raises(ProofError, match="another trial"):
        unseal(sealed, key.hex(), "deck 2")
