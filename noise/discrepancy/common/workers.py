"""Independent fits on several processors; what comes of them does not depend on how many there are."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

from loky import BrokenProcessPool, ProcessPoolExecutor, cpu_count, get_reusable_executor

from acquisition import SettingError
from noise.fitting.threads import keep_one_thread

T = TypeVar("T")
R = TypeVar("R")
MOST = 4  # processes by default: each wants some 400 MB, and part of the work is one fit after another; ours


@dataclass(frozen=True)
class Workers:
    """Processes that share out fits among them: threads would only wait for each other between small steps.

    Attributes:
        count: of processes; 1 does everything in this one.
    """

    count: int = 1

    def __post_init__(self) -> None:
        """Refuse none."""
        if self.count < 1:
            raise SettingError(f"workers must be 1 or more, got {self.count}")

    def start(self) -> None:
        """Let processes begin to load what they need, and do not wait for them."""
        if self.count > 1:
            for _ in range(self.count):
                self._executor().submit(keep_one_thread)

    def map(self, job: Callable[[T], R], items: Iterable[T]) -> list[R]:
        """Return what a job makes of each item, in their order; no job may change what another sees.

        Raises:
            SettingError: a process was killed from outside.
        """
        waiting = list(items)
        if self.count == 1 or len(waiting) < 2:
            return [job(item) for item in waiting]
        try:
            return list(self._executor().map(job, waiting))
        except BrokenProcessPool as error:
            raise SettingError(
                f"one of {self.count} worker processes was killed, for want of memory perhaps: give fewer workers"
            ) from error

    def _executor(self) -> ProcessPoolExecutor:
        return get_reusable_executor(self.count, timeout=60, initializer=keep_one_thread, env={"OMP_NUM_THREADS": "1"})


ALONE = Workers()


def usable() -> int:
    """Return how many processes are worth starting on this machine."""
    return min(MOST, int(cpu_count()))
