"""Who runs trials: threads that each keep three processes of their own, here or on a Ray cluster."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Lock, local
from types import TracebackType
from typing import Any, Protocol

from acquisition import MissingExtraError
from training.proof.desk import Desk, DeskError

TRIES = 2  # a worker that dies takes one trial with it, which is run once more


class Bench(Protocol):
    """Three processes that share a disk and nothing else."""

    def ask(self, module: str, question: dict[str, Any]) -> dict[str, Any]:
        """Return a process's answer."""

    def tidy(self, folder: str, keep: bool) -> None:
        """Take a trial's recordings away."""

    def close(self) -> None:
        """End the processes."""


class Local:
    """Processes on this machine, started when they are first asked."""

    def __init__(self) -> None:
        """Start nothing yet."""
        self.desks: dict[str, Desk] = {}

    def ask(self, module: str, question: dict[str, Any]) -> dict[str, Any]:
        """Return a process's answer."""
        if module not in self.desks:
            self.desks[module] = Desk(f"training.proof.{module}")
        return self.desks[module].ask(question)

    def tidy(self, folder: str, keep: bool) -> None:
        """Take a trial's recordings away."""
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)

    def close(self) -> None:
        """End the processes."""
        for desk in self.desks.values():
            desk.close()


class OnRay:
    """An actor on a Ray cluster that keeps such processes; the trials' folders are on that node's own disk."""

    def __init__(self) -> None:
        """Join the cluster, or start one on this machine."""
        try:
            import ray
        except ModuleNotFoundError:
            raise MissingExtraError("--engine ray needs the package 'ray': pip install 'sonar-gym[ray]'") from None
        if not ray.is_initialized():
            ray.init(log_to_driver=False, include_dashboard=False)
        self.ray = ray
        self.actor = ray.remote(num_cpus=1)(Local).remote()

    def ask(self, module: str, question: dict[str, Any]) -> dict[str, Any]:
        """Return a process's answer.

        Raises:
            DeskError: the process failed, or its node is gone.
        """
        try:
            answer: dict[str, Any] = self.ray.get(self.actor.ask.remote(module, question))
        except self.ray.exceptions.RayError as error:
            raise DeskError(f"a worker of the cluster was lost: {type(error).__name__}") from None
        return answer

    def tidy(self, folder: str, keep: bool) -> None:
        """Take a trial's recordings away."""
        self.ray.get(self.actor.tidy.remote(folder, keep))

    def close(self) -> None:
        """Let the actor go."""
        self.ray.kill(self.actor)


ENGINES: dict[str, Callable[[], Bench]] = {"local": Local, "ray": OnRay}


class Crew:
    """Threads that each keep a bench; a bench that fails is replaced."""

    def __init__(self, engine: Callable[[], Bench], workers: int) -> None:
        """Take on workers."""
        self.engine, self.pool = engine, ThreadPoolExecutor(workers)
        self.own, self.benches, self.turn = local(), list[Bench](), Lock()

    def __enter__(self) -> Crew:
        """Begin."""
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        """End every process; what was not begun is given up."""
        self.pool.shutdown(wait=kind is None, cancel_futures=True)
        for bench in self.benches:
            bench.close()

    def submit(self, work: Callable[..., None], job: Any, book: Any) -> Future[None]:
        """Hand in a trial."""
        return self.pool.submit(self._run, work, job, book)

    def _run(self, work: Callable[..., None], job: Any, book: Any) -> None:
        for attempt in range(TRIES):
            try:
                return work(self._bench(), job, book)
            except DeskError:
                self.own.bench = None
                if attempt + 1 == TRIES:
                    raise
        return None

    def _bench(self) -> Bench:
        if getattr(self.own, "bench", None) is None:
            self.own.bench = self.engine()
            with self.turn:
                self.benches.append(self.own.bench)
        return self.own.bench
