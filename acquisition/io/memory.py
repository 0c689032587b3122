"""A limit of the memory that reading a file may take, where the operating system has one (Linux)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

SIZES = Path("/proc/self/statm")  # of this process, in pages; the first is that of its address space


@contextmanager
def memory_limited(n_bytes: int) -> Iterator[None]:
    """Raise MemoryError where the process takes so many bytes more than now; elsewhere than on Linux, never.

    The limit is that of the address space of the whole process, so that it holds for libraries in C too. Threads
    beside this one share it.
    """
    if not SIZES.is_file():
        yield
        return
    import resource

    old, hard = resource.getrlimit(resource.RLIMIT_AS)
    wanted = int(SIZES.read_text().split()[0]) * resource.getpagesize() + n_bytes
    limits = [each for each in (old, hard) if each != resource.RLIM_INFINITY]
    with suppress(ValueError, OSError):  # a system that forbids the change keeps its own limit
        resource.setrlimit(resource.RLIMIT_AS, (min([wanted, *limits]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (old, hard))
