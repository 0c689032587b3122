"""One thread for torch: as fast for small tensors, and sums that do not depend on the number of cores."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


def keep_one_thread() -> None:
    """Limit torch to one thread until this process ends."""
    torch.set_num_threads(1)


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit torch to one thread, and restore the number of threads on exit."""
    before = torch.get_num_threads()
    keep_one_thread()
    try:
        yield
    finally:
        torch.set_num_threads(before)
