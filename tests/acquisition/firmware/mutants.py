"""Mutation of the sketch: small changes of its text, each of which the tests in `test_sketch` should notice.

No package mutates Arduino's dialect without a compiler of its own, so that the operators are those of the literature
(Offutt et al., ACM TOSEM 5, 1996) on the text: relations, logical and arithmetic operators, constants, deleted
statements.
"""

import os
import re
import resource
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.acquisition.firmware.host import LIBRARY, compile_sketch

TIMEOUT_S = 10  # of processor time, so that a busy machine kills no mutant
# pattern and its replacements
OPERATORS = [
    (r"(?<![<>=!\-])<(?![<=])", ["<=", ">="]),
    (r"(?<![<>=!\-])>(?![>=])", [">=", "<="]),
    (r"<=", ["<", ">"]),
    (r"(?<![>])>=(?!=)", [">", "<"]),
    (r"==", ["!="]),
    (r"!=", ["=="]),
    (r"&&", ["||"]),
    (r"\|\|", ["&&"]),
    (r"(?<=\w) \+ (?=\w)", [" - "]),
    (r"(?<=\w) - (?=\w)", [" + "]),
    (r"\+=", ["-="]),
    (r"-=(?!\d)", ["+="]),
    (r"(?<![\w!=])!(?=[\w*(])", [""]),
    (r"\btrue\b", ["false"]),
    (r"\bfalse\b", ["true"]),
    (r"\bHIGH\b", ["LOW"]),
    (r"\bLOW\b", ["HIGH"]),
    (r"\bINPUT\b", ["OUTPUT"]),
    (r"\bOUTPUT\b", ["INPUT"]),
    (r"(?<=return )[A-Z][A-Z_]+(?=;)", ["NO_ERROR", "SHORT_READ"]),
]
NUMBER = re.compile(r"(?<![\w'.])(0x[0-9A-Fa-f]+|\d+)(?:UL)?(?![\w'.])")
STATEMENT = re.compile(r"^\s*(?:[A-Za-z_][\w.]*\([^;{}]*\)|\w+(?:\+\+|--)|[*\w\[\]]+ [-+]?= [^;{}]+);$")


@dataclass(frozen=True)
class Mutant:
    """A changed sketch: number of the line from 1, the line before and after, and the whole text."""

    line: int
    before: str
    after: str
    text: str

    def __str__(self):
        return f"line {self.line}: {self.before.strip()}  ->  {self.after.strip() or '(deleted)'}"


def mutants(text):
    """Return all mutants of a sketch."""
    lines, out = text.splitlines(), []
    for k, line in enumerate(lines):
        if line.startswith(("#", "//")):
            continue
        for after in dict.fromkeys(_changed(line)):
            if after != line:
                out.append(Mutant(k + 1, line, after, "\n".join([*lines[:k], after, *lines[k + 1 :]]) + "\n"))
    return out


def _changed(line):
    """Yield changed versions of a line, but not of its comment, its casts and its types."""
    code = line.split("//")[0]
    for pattern, replacements in OPERATORS:
        for match in re.finditer(pattern, code):
            if "_cast<" in code[: match.start() + 1][-20:] or re.search(r"_cast<[^>]*$", code[: match.start()]):
                continue
            yield from (code[: match.start()] + new + code[match.end() :] for new in replacements)
    for match in NUMBER.finditer(code):
        value = int(match[1], 0)
        new = 2 * value if value >= 1000 else value + 1  # one microsecond more would change nothing
        yield code[: match.start()] + str(new) + code[match.end() :]
    if STATEMENT.match(code.rstrip()):
        yield ""


def survivors(every, folder):
    """Return the mutants that all tests pass, and those that do not compile."""
    alive, invalid = [], []
    for k, mutant in enumerate(every):
        library = folder / f"mutant{k}.so"
        if not compile_sketch(mutant.text, library):
            invalid.append(mutant)
        elif not _killed(library):
            alive.append(mutant)
    return alive, invalid


def _killed(library):
    """Return whether a test fails in a child process, which ends after `TIMEOUT_S` where the sketch never returns."""
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (TIMEOUT_S, TIMEOUT_S))
        os.environ[LIBRARY] = str(library)
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        tests = str(Path(__file__).with_name("test_sketch.py"))
        # the plugin's limit would replace that of this process
        os._exit(int(pytest.main(["-x", "-q", "--timeout", "0", "-p", "no:cacheprovider", tests])))
    return os.waitpid(child, 0)[1] != 0
