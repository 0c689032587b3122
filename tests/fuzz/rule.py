"""The rule of the fuzz suite: an input is used, or rejected with one line that names its reason, and no more."""

import contextlib
import hashlib
import io
import os
import resource
import signal

from hypothesis import HealthCheck, settings

from training.cli import main

# `make test` repeats the same few examples of each test; `make fuzz` sets the number and draws new ones
EXAMPLES = int(os.environ.get("SONAR_GYM_FUZZ", "0"))
FUZZ = settings(
    max_examples=EXAMPLES or 4,
    derandomize=not EXAMPLES,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)

SECONDS, MEMORY_KIB = 10, 1024 * 1024  # limits of one input
MAX_LINE = 300 + len("sonar-gym: ")


class Hang(BaseException):
    """An input took too long; no handler of the program catches it."""


@contextlib.contextmanager
def limited(what):
    """Fail if the block takes more than 10 s, or 1 GiB beyond what the process used before."""

    def stop(*_):
        raise Hang(f"more than {SECONDS} s: {what}")

    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    timers = ((signal.ITIMER_PROF, signal.SIGPROF, SECONDS), (signal.ITIMER_REAL, signal.SIGALRM, 6 * SECONDS))
    before = [signal.signal(number, stop) for _, number, _ in timers]
    for timer, _, seconds in timers:  # processor time, as the machine may be busy; and time, for what waits
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for (timer, number, _), handler in zip(timers, before, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, handler)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - used
    assert grown < MEMORY_KIB, f"{grown / 1024:.0f} MiB: {what}"


def run(*argv):
    """Return exit code and stderr of a command."""
    argv = [str(word) for word in argv]
    out, err = io.StringIO(), io.StringIO()
    with limited(argv), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(argv)
            code = 0
        except SystemExit as left:
            code = left.code
    return code, err.getvalue()


def check_rejected(*argv, names=()):
    """Check that a command rejects its input with one line that contains `names`; return the line."""
    code, text = run(*argv)
    assert code == 2, f"exit code {code} of {argv}: {text}"
    check_line(text, argv)
    for name in names:
        assert str(name) in text, f"{name!r} is not in {text!r}"
    return text


def check_used_or_rejected(*argv):
    """Check that a command uses its input, or rejects it with one line."""
    code, text = run(*argv)
    assert code in (0, 2), f"exit code {code} of {argv}: {text}"
    if code:
        check_line(text, argv)
    return code


def check_line(text, argv):
    assert text.startswith("sonar-gym: "), f"{argv}: {text}"
    assert text.endswith("\n"), f"{argv}: {text}"
    line = text[:-1]
    assert line.isprintable(), f"{argv}: {text!r}"
    assert len(line) <= MAX_LINE, f"{argv}: {text}"


def digests(folder):
    """Return the content of all files of a folder, by path."""
    return {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.rglob("*") if path.is_file()}
