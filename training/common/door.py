"""From a failure to one line on stderr: every command runs behind this door.

A failure that the user can correct ends with exit code 2; any other with exit code 1 and a crash file, which can be
attached to a report.
"""

from __future__ import annotations

import contextlib
import errno
import io
import itertools
import os
import platform
import re
import sqlite3
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor
from importlib.metadata import PackageNotFoundError, version

from acquisition import SonarError
from acquisition.name_check import foreign

USAGE_ERROR, CRASHED, INTERRUPTED = 2, 1, 130
QUOTED = re.compile(r"'[^']{61,}'")
MAX_LINE, MAX_PATH, MAX_WORD = 300, 160, 60  # characters of a message, and of a path or another word in it
BORDER, RULE = "│╭╮╰╯|+ \t", "─-"  # of the box around an error of the parser, also in plain ASCII
PLAIN = {  # what the parser says of a value, and what a user can read
    r"invalid literal for int\(\) with base 10: (.*)": r"expected a whole number, got \1",
    r"could not convert string to float: (.*)": r"expected a number, got \1",
    r"no type matching (?:\{None\}\|)?(.*) could be instantiated from \[(.*)\]": r"expected \1, got \2",
    r"Could not find valid parse for arguments: \[(.*)\]": r"not all of its values are of its type: \1",
    r"expected INT,": "expected a whole number,",
    r"expected FLOAT,": "expected a number,",
    r"expected {FLOAT FLOAT FLOAT},": "expected three numbers,",
    r"(?<=Unrecognized options:)$": " ''",
}
GAP = "..."  # in place of words that are left out
PACKAGES = ("sonar-gym", "numpy", "pandas", "torch", "gymnasium", "numba", "scipy")  # whose versions explain a crash
EXTRAS = {"serial": "record", "smbus2": "record"}  # package -> extra, of packages that a core install lacks
ADVICE = {
    errno.ENOSPC: "free disk space or give another folder",
    errno.EDQUOT: "free disk space or give another folder",
    errno.EACCES: "give a place that you may use, or change its permissions",
    errno.EPERM: "give a place that you may use, or change its permissions",
    errno.EROFS: "it is on a read-only disk: give another place",
    errno.EISDIR: "give the name of a file",
    errno.ENOTDIR: "a part of the path is a file: give another path",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.ENOENT: "check the path",
    errno.ENOTEMPTY: "another process wrote it meanwhile: give another folder",
    errno.EMFILE: "close other programs, or use fewer workers",
    errno.ENOMEM: "close other programs, or use fewer workers",
}


@contextlib.contextmanager
def door(argv: Sequence[str], debug: bool = False) -> Iterator[None]:
    """Turn a failure of the block into one line and an exit code.

    Args:
        argv: command line, for the crash file.
        debug: show the traceback instead.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files may hold what a terminal cannot show
    try:
        yield
    except (KeyboardInterrupt, BrokenPipeError) as error:
        _leave(error)
    except Exception as error:
        if debug:
            raise
        reason = reason_of(error)
        if reason is not None:
            stop(reason)
        stop(f"unexpected {type(error).__name__}: {error}; details: {crash_file(argv, error)}", CRASHED)


def _leave(error: BaseException) -> None:
    if isinstance(error, BrokenPipeError):  # of `sonar-gym effects | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # or Python reports the same error when it flushes stdout
        raise SystemExit(CRASHED) from None
    stop(f"interrupted; {str(error) or 'all files written so far are complete'}", INTERRUPTED)


def reason_of(error: BaseException) -> str | None:
    """Return what the user is told about a foreseeable failure; None for any other."""
    if isinstance(error, SonarError):
        return str(error)
    if isinstance(error, ImportError | AttributeError) and (hidden := foreign()) is not None:
        return hidden
    if isinstance(error, ModuleNotFoundError) and error.name in EXTRAS:
        return f"needs the package {error.name!r}: pip install 'sonar-gym[{EXTRAS[error.name]}]'"
    if isinstance(error, MemoryError):
        return f"not enough memory ({error}): use a shorter recording, smaller settings or fewer workers"
    if isinstance(error, BrokenExecutor):
        return "a worker process was ended by the system, perhaps for its memory: use fewer workers, and run it again"
    if isinstance(error, sqlite3.Error) and getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
        return f"the output: {os.strerror(errno.ENOSPC)}: {ADVICE[errno.ENOSPC]}"
    if isinstance(error, OSError) and error.errno is not None:
        named = error.filename2 or error.filename  # the second is that to which a file was to be moved
        place = named if named is not None else "the output or a file"
        place = os.fsdecode(place) if isinstance(place, bytes | os.PathLike) else str(place)
        return f"{place}: {error.strerror}: {ADVICE.get(error.errno, 'check the disk and the path')}"
    return None


def stop(message: str, code: int = USAGE_ERROR) -> None:
    """Print one line on stderr and leave with an exit code."""
    print(f"sonar-gym: {one_line(message)}", file=sys.stderr)
    raise SystemExit(code) from None


def one_line(message: str) -> str:
    r"""Return a message as one printable line of limited length; paths stay in it.

    >>> one_line("a\x1b[2J\nfile.csv: no such file")
    'a\\x1b[2J file.csv: no such file'
    """
    text = "".join(map(_printable, message.strip()))
    text = QUOTED.sub(lambda quoted: _shortened(quoted[0]), text)  # a long value must not push out what it is of
    words = [_shortened(word) for word in text.split(" ")]
    if len(" ".join(words)) > MAX_LINE:
        words = _without_middle(words)
    return " ".join(words)[:MAX_LINE]


def _without_middle(words: list[str]) -> list[str]:
    """Return words that fit into a line: all paths, the start, which says where, and the end, which says what to do."""
    last, chosen = len(words) - 1, {k for k, word in enumerate(words) if os.sep in word}
    room = MAX_LINE - sum(len(words[k]) + 1 + 2 * len(GAP) for k in chosen) - 2 * len(GAP)
    for k in sorted(set(range(len(words))) - chosen, key=lambda k: min(k, 2 * (last - k))):
        room -= len(words[k]) + 1
        if room < 0:
            break
        chosen.add(k)
    kept = [word if k in chosen else GAP for k, word in enumerate(words)]
    return [word for k, word in enumerate(kept) if k == 0 or word != GAP or kept[k - 1] != GAP]


def _printable(character: str) -> str:
    if character == "\n":
        return " "
    return character if character.isprintable() else character.encode("unicode_escape", "surrogatepass").decode()


def _shortened(word: str) -> str:
    """Return a word of limited length, without its middle: the end of a path is its name."""
    longest = MAX_PATH if os.sep in word else MAX_WORD
    return word if len(word) <= longest else f"{word[: longest // 2 - 3]}...{word[-longest // 2 :]}"


def crash_file(argv: Sequence[str], error: BaseException) -> str:
    """Write what explains a failure to a new file in the temporary folder, and return its path."""
    lines = [
        f"command: {' '.join(['sonar-gym', *argv])!r}",
        f"system: Python {platform.python_version()}, {platform.platform()}",
        f"packages: {', '.join(filter(None, map(_version, PACKAGES)))}",
        "",
        "".join(traceback.format_exception(error)),
    ]
    try:
        handle, path = tempfile.mkstemp(prefix="sonar-gym-crash-", suffix=".txt", text=True)
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write("\n".join(lines))
    except OSError as failed:
        return f"(no crash file: {failed.strerror}; repeat with --debug)"
    return path


def _version(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return ""


@contextlib.contextmanager
def parsing(command: str) -> Iterator[None]:
    """Turn the parser's error, a box of several lines, into one line; help is printed as it is."""
    captured = io.StringIO()
    try:
        with contextlib.redirect_stderr(captured):
            yield
    except SystemExit as left:
        if left.code in (0, None):
            raise
        stop(f"{command}: {_unboxed(captured.getvalue())} See `sonar-gym {command} --help`")


def _unboxed(text: str) -> str:
    """Return the first paragraph inside a box in plain words, and the option nearest to an unknown one."""
    inside = (line.strip(BORDER) for line in text.split("\n")[1:])  # a value may hold other line ends
    rows = [row if row.strip(RULE) else "" for row in inside]
    reason = " ".join(itertools.takewhile(bool, itertools.dropwhile(lambda row: not row, rows)))
    reason = reason.removeprefix("Error parsing Args: ").removeprefix("Error parsing ").rstrip(".")
    for words, plain in PLAIN.items():
        reason = re.sub(words, plain, reason)
    hint = next((row for before, row in itertools.pairwise(rows) if before.startswith("Perhaps you meant")), "")
    return f"{reason}; did you mean {hint.split()[0]}?" if hint else f"{reason}."
