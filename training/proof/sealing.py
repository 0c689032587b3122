"""Answers sealed by authenticated encryption (ChaCha20-Poly1305, RFC 8439), each with a key of its own.

The cipher does not bind a ciphertext to one key, so the SHA-256 of the key is published with it (Albertini et al. 2022,
How to abuse and fix authenticated encryption without key commitment). All answers have the same length, which tells
nothing about the kind of trial.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from training.common.checksum import canonical, sha256
from training.proof.chain import ProofError

BLOCK = 2048  # bytes of a padded answer; four times the longest of 144 pairs and faults
N_NONCE = 12  # bytes, as the cipher requires
SEALED = ("ciphertext", "nonce", "key_sha256")  # entries of `seal`


def seal(answer: Mapping[str, Any], key: bytes, context: str) -> dict[str, str]:
    """Return ciphertext, nonce and hash of the key, hexadecimal.

    Args:
        answer: what is concealed.
        key: 32 bytes, used once.
        context: authenticated with the answer; a ciphertext that is moved to another context cannot be opened.
    """
    text = canonical(answer).encode()
    padded = text.ljust(-(-len(text) // BLOCK) * BLOCK)
    nonce = os.urandom(N_NONCE)
    sealed = ChaCha20Poly1305(key).encrypt(nonce, padded, context.encode())
    return {"ciphertext": sealed.hex(), "nonce": nonce.hex(), "key_sha256": sha256(key)}


def unseal(sealed: Mapping[str, Any], key: str, context: str) -> dict[str, Any]:
    """Return the answer.

    Args:
        sealed: entries of `seal`.
        key: hexadecimal.
        context: as it was given to `seal`.

    Raises:
        ProofError: the key is not the one that was committed to, or the ciphertext was changed or moved.
    """
    try:
        secret = bytes.fromhex(key)
        if sha256(secret) != sealed["key_sha256"]:
            raise ProofError("the disclosed key is not the one that was committed to")
        cipher, nonce = bytes.fromhex(sealed["ciphertext"]), bytes.fromhex(sealed["nonce"])
        answer: dict[str, Any] = json.loads(ChaCha20Poly1305(secret).decrypt(nonce, cipher, context.encode()))
    except (InvalidTag, ValueError):
        raise ProofError("the sealed answer cannot be opened: it was changed, or belongs to another trial") from None
    return answer
