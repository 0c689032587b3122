"""Every snippet of README and docs is a test.

Python is run, page by page in one namespace, in a folder that holds recordings (REC.csv, SIM.csv, ...). Lines of `sh`
are run if they call `sonar-gym`; targets of `make` and extras of `pip install` must exist. A comment above a snippet
changes this: `<!-- slow -->` leaves it to the slow tests; `<!-- parsed -->` marks what needs hardware, another program
or hours, of which only the options are checked; `<!-- server -->` starts `sonar-gym serve ideal` first.
"""

import asyncio
import contextlib
import os
import re
import shlex
import shutil
import tempfile
import threading
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from sybil import Document, Example, Sybil
from sybil.evaluators.python import PythonEvaluator
from sybil.parsers.markdown import CodeBlockParser

ROOT = Path(__file__).parent
MARK = re.compile(r"<!-- (\w+) -->\s*$")
KINDS = {"python", "sh", "toml", "text"}  # of code that may appear in the pages
SIMULATOR = "def sonar(pings, rng):\n    return pings.distance + 0.003 * rng.standard_normal(len(pings))\n"
LOG = "true_cm,echo,when,file\n100,5800,2026-05-01T12:00:00,a\n150,38000,2026-05-01T12:00:01,a\n"
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("MPLBACKEND", "Agg")


def mark_of(example: Example) -> str:
    """Return the mark above a snippet, or nothing."""
    found = MARK.search(example.document.text[: example.region.start])
    return found[1] if found else ""


@cache
def materials() -> Path:
    """Return a folder with the files that the snippets read, made once per process."""
    from acquisition import Ping
    from acquisition.bench import Rig, Setup, Unit

    folder = Path(tempfile.mkdtemp(prefix="snippets-"))
    distance, angle = np.meshgrid(np.linspace(0.2, 3.0, 8), np.radians([0.0, 10.0, 20.0]))
    n_visits, pings = distance.size, 20  # enough for a diagnosis to name a cause
    ping = Ping.of(
        distance=np.repeat(distance.ravel(), pings),
        angle=np.repeat(angle.ravel(), pings),
        incidence=0.0,
        reflectance=0.9,
        time=0.1 * np.arange(n_visits * pings),
    )
    for seed, (name, zero_m) in enumerate((("REC", 0.03), ("SIM", 0.0))):
        rig = Rig(Unit.nominal(), Setup(gain=31, zero_m=zero_m))
        rig.record(ping, np.random.default_rng(seed)).save(folder / f"{name}.csv")
    shutil.copy(folder / "REC.csv", folder / "recording.csv")
    (folder / "mine.py").write_text(SIMULATOR)
    (folder / "log.csv").write_text(LOG)
    return folder


def enter(namespace: dict) -> None:
    """Go to a folder of the page's own."""
    namespace["_from"], namespace["_closing"] = Path.cwd(), contextlib.ExitStack()
    folder = namespace["_closing"].enter_context(tempfile.TemporaryDirectory())
    shutil.copytree(materials(), folder, dirs_exist_ok=True)
    os.chdir(folder)


def leave(namespace: dict) -> None:
    """Return, remove the folder, and stop what still runs."""
    os.chdir(namespace["_from"])
    namespace["_closing"].close()


def run_python(example: Example) -> None:
    """Run a snippet of Python."""
    if mark_of(example) == "server":
        example.namespace["_closing"].enter_context(served())
    PythonEvaluator()(example)


@contextlib.contextmanager
def served() -> Iterator[None]:
    """Answer pings at the default port."""
    from sonar_gym.bridges.server.server import SonarServer

    ready, loop = threading.Event(), asyncio.new_event_loop()
    task = loop.create_task(SonarServer("ideal").run(ready.set))
    thread = threading.Thread(target=lambda: loop.run_until_complete(asyncio.wait([task])))
    thread.start()
    ready.wait(10)
    yield
    loop.call_soon_threadsafe(task.cancel)
    thread.join()
    loop.close()


def run_shell(example: Example) -> None:
    """Run or check each line of a snippet of shell."""
    for line in example.parsed.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words:
            check_line(words, parsed=mark_of(example) == "parsed")


def check_line(words: list[str], parsed: bool) -> None:
    """Run `sonar-gym`, or check its options; check the names that `make` and `pip` are given."""
    from training import cli

    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.MULTILINE), words
    elif words[:2] == ["pip", "install"]:
        check_extras(words[2:])
    elif words[0] == "git":
        assert words[1] == "clone"
    else:
        assert words[0] == "sonar-gym", words
        target = words[words.index(">") + 1] if ">" in words else os.devnull
        arguments = words[1 : words.index(">")] if ">" in words else words[1:]
        with open(target, "w") as file, contextlib.redirect_stdout(file):
            if parsed:
                cli.settings_of(arguments[0], arguments[1:])
            else:
                with contextlib.suppress(SystemExit) if "--help" in words else contextlib.nullcontext():
                    cli.main(arguments)


def check_extras(words: list[str]) -> None:
    """Check that a distribution is this one and has the extras."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for found in re.findall(r"\[([\w,]+)\]", " ".join(words)):
        assert set(found.split(",")) <= set(extras), words


def read_toml(example: Example) -> None:
    """Read a snippet of TOML."""
    tomllib.loads(example.parsed)


def no_other_code(document: Document) -> tuple[()]:
    """Check that no code escapes: each fence names a language that is known here."""
    fences = re.findall(r"^```(.*)$", document.text, re.MULTILINE)[::2]
    assert set(fences) <= KINDS, f"{document.path}: code of an unknown kind: {set(fences) - KINDS}"
    return ()


pytest_collect_file = Sybil(
    parsers=[
        no_other_code,
        CodeBlockParser("python", run_python),
        CodeBlockParser("sh", run_shell),
        CodeBlockParser("toml", read_toml),
    ],
    patterns=["README.md", *("docs/" + depth * "*/" + "*.md" for depth in range(4))],
    excludes=["*/README.md"],
    setup=enter,
    teardown=leave,
).pytest()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark slow snippets."""
    for item in items:
        example = getattr(item, "example", None)
        if isinstance(example, Example) and mark_of(example) == "slow":
            item.add_marker(pytest.mark.slow)
