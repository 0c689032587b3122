"""Every option of every command: a bad value is one line that names the option."""

import dataclasses
import importlib
import math
import os
import typing
from pathlib import Path

import pytest
import tyro
from hypothesis import given
from hypothesis import strategies as st

from acquisition.io.places import Output
from acquisition.limits import Limit, Loadable, OneOf, hints_of
from tests.fuzz.rule import FUZZ, check_rejected
from training.cli import COMMANDS


def arguments():
    """Return the class of the arguments of each command, those with words of their own by all their words."""
    out = {}
    for name, (module, _) in COMMANDS.items():
        args = importlib.import_module(f"training.{module}").Args
        if dataclasses.is_dataclass(args):
            out[name] = args
        else:
            out |= {f"{name} {arm.__metadata__[0].name}": arm.__origin__ for arm in typing.get_args(args)}
    return out


ARGS = arguments()
NO_NUMBER = (
    "x",
    "",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "1,5",
    "0x1p3",
    "--",
    "None1",
    "1e400",
    "\x1b[31m",
    "½",
    "--5",
    "٣x",
    "true",
)
NO_NAME = ("", "nosuch", "..", "\x00", "ideal\n", "/dev/null", "a" * 5000, "/proc/self/mem", "\udcff", "💥", " ", "-")


def parts(hint):
    """Yield a type and all that it is made of."""
    yield hint
    for part in typing.get_args(hint):
        if not isinstance(part, (str, int)):
            yield from parts(part)


def numeric(hint):
    return next((part for part in parts(hint) if part in (int, float)), None)


def extra(hint, kind):
    return next((part for part in parts(hint) if isinstance(part, kind)), None)


OPTIONS = [(name, field, hint) for name, cls in ARGS.items() for field, hint in hints_of(cls)]
NUMBERS = [option for option in OPTIONS if numeric(option[2])]
NAMES = [
    o
    for o in OPTIONS
    if extra(o[2], OneOf) or extra(o[2], Loadable) or any(typing.get_origin(p) is typing.Literal for p in parts(o[2]))
]
INPUTS = [o for o in OPTIONS if Path in parts(o[2]) and not extra(o[2], Output)]
PLACES = [option for option in OPTIONS if extra(option[2], Output)]
ids = lambda options: [f"{name} {field}" for name, field, _ in options]  # noqa: E731


def choices_of(hint):
    return next((typing.get_args(p) for p in parts(hint) if typing.get_origin(p) is typing.Literal), ())


def shown_as(name, field):
    """Return an option as messages name it."""
    return field if positional(ARGS[name], field) else f"--{field.replace('_', '-')}"


def positional(cls, field):
    return tyro.conf.Positional in typing.get_args(dict(hints_of(cls))[field])


def command(name, valid, unused, /, **changed):
    """Return the words of a command whose required options are valid, except those that are changed."""
    cls = ARGS[name]
    words, first = name.split(), []
    n_words = len(words)
    for field in dataclasses.fields(cls):
        required = field.default is dataclasses.MISSING
        if field.name in changed:
            value = changed[field.name]
        elif field.name == "out":
            value = [unused]
        elif required and (choices := choices_of(dict(hints_of(cls))[field.name])):
            value = [choices[0]]
        elif required:
            value = [valid / ("model" if field.name in ("agent", "networks") else "recording.csv")]
        else:
            continue
        if positional(cls, field.name):
            first += value
        else:
            words += [f"--{field.name.replace('_', '-')}", *value]
    return [*map(str, words[:n_words]), *map(str, first), *map(str, words[n_words:])]


@st.composite
def bad_numbers(draw, hint):
    """Text that is not a number within the limits of an option."""
    kind, limit = numeric(hint), extra(hint, Limit)
    outside = [
        v
        for v in (limit.low - 1, limit.high + 1, limit.low * 10 - 3, limit.high * 1e6)
        if math.isfinite(v) and not limit.holds(v)
    ]
    if kind is int and limit.high < 10**30:
        outside = [int(v) for v in outside] + [10**30, -(10**30), 1.5, 1e3]
    else:
        outside += [1e300, -1e300] if math.isfinite(limit.high) else []
    count = 3 if "tuple[" in str(hint) and "..." not in str(hint) and "Ellipsis" not in str(hint) else 1
    words = [text for text in NO_NUMBER if count == 1 or text != "--"]  # of several, the first ends the options
    text = draw(st.sampled_from([*words, *map(str, outside)]))
    return [text] * count


@pytest.mark.parametrize(("name", "field", "hint"), NUMBERS, ids=ids(NUMBERS))
def test_every_number_has_limits(name, field, hint):
    assert extra(hint, Limit) is not None


@pytest.mark.parametrize(("name", "field", "hint"), NUMBERS, ids=ids(NUMBERS))
@FUZZ
@given(data=st.data())
def test_a_bad_number_is_named(valid, tmp_path_factory, name, field, hint, data):
    out = tmp_path_factory.getbasetemp() / "unused"
    words = command(name, valid, out, **{field: data.draw(bad_numbers(hint))})
    check_rejected(*words, names=[shown_as(name, field)])
    assert not out.exists()


@pytest.mark.parametrize(("name", "field", "hint"), NAMES, ids=ids(NAMES))
@FUZZ
@given(data=st.data())
def test_an_unknown_name_is_named(valid, tmp_path_factory, name, field, hint, data):
    out = tmp_path_factory.getbasetemp() / "unused"
    text = data.draw(st.one_of(st.sampled_from(NO_NAME), st.text(min_size=3, max_size=20).map(lambda t: f"no {t}")))
    check_rejected(*command(name, valid, out, **{field: [text]}), names=[shown_as(name, field)])


@pytest.mark.parametrize(("name", "field", "hint"), PLACES, ids=ids(PLACES))
def test_a_place_that_cannot_be_written_is_named(valid, tmp_path, name, field, hint):
    mark = extra(hint, Output)
    folder = mark.kind == "folder"
    (tmp_path / "file").write_text("kept")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    bad = [tmp_path / "file" / "x", tmp_path / "link", "/proc/nowhere/x", tmp_path / ("n" * 300), "\x00", "\udcff"]
    bad += [tmp_path / "file", valid / "model" / "x"] if folder else [tmp_path, "/dev/full", "/dev/null"]
    bad += [valid / "model"] if folder and mark.result != "model.json" else []
    for place in bad:
        words = command(name, valid, tmp_path / "unused", **{field: [place]})
        check_rejected(*words, names=[shown_as(name, field)])
    assert (tmp_path / "file").read_text() == "kept"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "link"]


# a page of an empty folder is empty, and the rig makes the recording of a comparison that does not exist
VALID_INPUTS = {("view", "folder", "folder"), ("view", "folder", ""), ("compare-optimizers", "recording", "missing")}


def unreadable(folder):
    """Make what no command can read, and yield its paths."""
    contents = {
        "empty": b"",
        "binary": bytes(range(256)) * 9,
        "text": b"nothing of that kind\n",
        "json": b"{}",
        "zip": b"PK",
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    (folder / "folder").mkdir()
    (folder / "link").symlink_to("nowhere")
    (folder / "loop").symlink_to("loop")
    os.mkfifo(folder / "pipe")
    return [
        *sorted(folder.iterdir()),
        folder / "missing",
        folder / ("n" * 300),
        folder / "empty" / "below",
        "",
        "\x00",
        "\udcff",
    ]


@pytest.mark.parametrize(("name", "field", "hint"), INPUTS, ids=ids(INPUTS))
def test_what_cannot_be_read_is_rejected(valid, tmp_path, name, field, hint):
    (tmp_path / "in").mkdir()
    real = {"driver": ["twin"]} if field == "thermometer" else {}  # the rig has its own air
    for path in unreadable(tmp_path / "in"):
        if (name, field, Path(path).name) not in VALID_INPUTS:
            check_rejected(*command(name, valid, tmp_path / "out", **{field: [path]}, **real))
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_what_is_read_is_not_written(valid, tmp_path):
    log = tmp_path / "log.csv"
    log.write_bytes((valid / "recording.csv").read_bytes())
    (tmp_path / "link.csv").symlink_to(log)
    for out in (log, tmp_path / "link.csv"):
        check_rejected("import", log, "--out", out, "--columns", "gain=time_s", names=["--out", "is also --source"])
    assert log.read_bytes() == (valid / "recording.csv").read_bytes()


@pytest.mark.parametrize("name", ARGS)
@FUZZ
@given(
    words=st.lists(
        st.one_of(
            st.text(max_size=30), st.sampled_from(["--", "-", "--seed", "--out", "-h1", "--no", "=", "--seed=", "@x"])
        ),
        min_size=1,
        max_size=6,
    )
)
def test_arbitrary_words_are_rejected(name, words):
    if not {"-h", "--help", "--debug"} & set(words):
        check_rejected(*name.split(), "--no-such-option", *words)
