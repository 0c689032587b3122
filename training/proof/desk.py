"""A process of its own that is asked questions over its pipes: what it does not get, it does not know."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TextIO

from acquisition import SonarError

ROOT = Path(__file__).parents[2]
KEPT = ("PATH", "HOME", "LANG", "LD_LIBRARY_PATH", "SYSTEMROOT", "TMPDIR", "VIRTUAL_ENV")


class DeskError(SonarError):
    """A process of the proof failed."""


class Desk:
    """A running module that answers one JSON object a line with one JSON object a line."""

    def __init__(self, module: str) -> None:
        """Start a module; its environment holds nothing but what Python needs."""
        environment = {name: os.environ[name] for name in KEPT if name in os.environ}
        threads = {f"{kind}_NUM_THREADS": "1" for kind in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
        self.module = module
        self.process = subprocess.Popen(
            [sys.executable, "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env={**environment, **threads, "PYTHONPATH": str(ROOT)},
        )

    def ask(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to a question.

        Raises:
            DeskError: the process failed or died.
        """
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write(json.dumps(question) + "\n")
            self.process.stdin.flush()
            line = self.process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            self.close()
            raise DeskError(f"{self.module} died with exit code {self.process.returncode}")
        answer: dict[str, Any] = json.loads(line)
        if "failed" in answer:
            raise DeskError(f"{self.module}: {answer['failed']}")
        return answer

    def close(self) -> None:
        """End the process."""
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()
        self.process.kill()
        self.process.wait()


def serve(answer: Callable[[dict[str, Any]], Mapping[str, Any]], asked: TextIO = sys.stdin) -> None:
    """Answer questions until there are no more; whatever else is printed goes to stderr."""
    told, sys.stdout = sys.stdout, sys.stderr
    for line in asked:
        try:
            reply = answer(json.loads(line))
        except Exception as error:
            reply = {"failed": f"{type(error).__name__}: {error}"}
        told.write(json.dumps(reply) + "\n")
        told.flush()
