"""Worker processes that end with their command, also where Ctrl-C interrupts it or it is killed."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path

from acquisition.io.files import UNFINISHED


@contextmanager
def worker_processes(
    count: int, begin: Callable[[], object] | None = None, start: str | None = "spawn"
) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of processes, which end with the block: at once where it raises, without what is still to be done.

    In a terminal, Ctrl-C reaches all processes of a command. The workers pass over it, so that only the first process
    answers, in one line.

    Args:
        count: number of processes.
        begin: called once in each.
        start: how they are started, as `multiprocessing` names it: anew, since a copy of a process with threads is
            unsafe; None for the default of the system.
    """
    pool = ProcessPoolExecutor(count, get_context(start), partial(_begin, begin))
    try:
        with _interrupts_held():  # what is started here holds them for ever
            for _ in range(count):
                pool.submit(int)
        yield pool
    except BaseException:
        for process in active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(begin: Callable[[], object] | None) -> None:
    """Begin in a worker."""
    signal.signal(signal.SIGTERM, _end)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if begin is not None:
        begin()


def _end_with_parent() -> None:
    """End when the process that started this one is no more, which a worker that waits for work does not see."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        _end(signal.SIGTERM, None)


def _end(number: int, _: object) -> None:
    """End a worker at once, without the files that it has not finished."""
    for path in UNFINISHED:
        Path(path).unlink(missing_ok=True)
    os._exit(128 + number)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C until the end of the block, where the operating system can."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
