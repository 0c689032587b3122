"""One thread for torch: as fast for tensors this small, and the same seed gives the same sums on every machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


def keep_one_thread() -> None:
    """Keep torch to one thread for as long as this process lives."""
    torch.set_num_threads(1)


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep torch to one thread, and give it its threads back."""
    before = torch.get_num_threads()
    keep_one_thread()
    try:
        yield
    finally:
        torch.set_num_threads(before)
