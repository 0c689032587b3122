"""The secret that fixes the trials of a deck, so that a deck whose hash is published can be run in one way only.

Family, kind, seed and key of each trial follow from it by HMAC with SHA-256 (RFC 2104). Its hash stands in the deck;
the closing line discloses it. Until then it is in a file beside the ledger, which only its owner can read.
"""

from __future__ import annotations

import hmac
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from acquisition.io.files import write_text
from training.common.checksum import sha256
from training.proof.chain import ProofError
from training.proof.deck import Cell, cells_of

FILE = "secret"
N_SECRET, N_SEED = 32, 16  # bytes


def new_secret(folder: Path) -> bytes:
    """Return a secret from the operating system, which is written to a file before a deck is bound to it."""
    secret = os.urandom(N_SECRET)
    (folder / FILE).unlink(missing_ok=True)
    (folder / FILE).touch(mode=0o600)  # a file that exists keeps its permissions when it is written
    write_text(folder / FILE, secret.hex())
    return secret


def secret_of(folder: Path, deck: Mapping[str, Any]) -> bytes:
    """Return the secret of a deck from its file.

    Raises:
        ProofError: the file is missing or is that of another deck.
    """
    path = folder / FILE
    try:
        return checked(path.read_text(encoding="ascii"), deck)
    except (OSError, ValueError):
        raise ProofError(
            f"{path}: is not the secret of deck {deck.get('hash')}, from which its trials follow; put it back, or "
            "begin another deck with another --out"
        ) from None


def checked(text: str, deck: Mapping[str, Any]) -> bytes:
    """Return a secret in hexadecimal digits as bytes.

    Raises:
        ValueError: it is not the one whose hash stands in the deck.
    """
    secret = bytes.fromhex(text)
    if sha256(secret) != deck["secret_sha256"]:
        raise ValueError("the secret is not that of the deck")
    return secret


def has_secret(deck: Mapping[str, Any]) -> bool:
    """Return whether trials follow from a secret; those of the first decks were drawn after they were published."""
    return "secret_sha256" in deck


def key_of(secret: bytes, trial: int) -> bytes:
    """Return the key of a trial, 32 bytes."""
    return _derived(secret, "key", trial)


def seed_of(secret: bytes, trial: int) -> int:
    """Return the seed of a trial."""
    return int.from_bytes(_derived(secret, "seed", trial)[:N_SEED])


def order_of(secret: bytes, deck: Mapping[str, Any]) -> list[Cell]:
    """Return family and kind of each trial: those of the plan in a random order."""
    cells = sorted(cells_of(deck).elements())
    shuffled = sorted(range(len(cells)), key=lambda trial: _derived(secret, "cell", trial))
    return [cells[k] for k in shuffled]


def _derived(secret: bytes, use: str, trial: int) -> bytes:
    return hmac.digest(secret, f"{use} {trial}".encode(), "sha256")
