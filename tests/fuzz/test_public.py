"""Public functions: a wrong argument is rejected by an error of the project that names it."""

import itertools
import math
import os
import random
import stat
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from acquisition import Ping, Reading, SonarError
from noise import IdealModel, PhysicalModel
from sonar_gym.sensing.mounts import layout
from tests.fuzz.calls import calls
from tests.fuzz.rule import FUZZ, limited

FOREIGN = object()  # an argument of any function
# what else may stand where numbers, text, tables or models are expected
STRANGE = (
    None, True, math.nan, math.inf, -math.inf, -1, 0, "", "x", "\x00", "a" * 5000, b"", b"x", (), [], {}, set(), [()],
    [None], ["x"], [[1.0], [2.0, 3.0]],
    np.zeros(0), np.zeros((2, 2, 2)), np.zeros((0, 2)), np.array(["a", "b"]), np.array([None, 1]), np.array(1.0),
    np.array([1j, 2j]), 1j, object, len, {"a": 1}, {1: 2}, range(3), Path("pipe"), "pipe", "link",
    np.float32(3), np.int64(-5), 10**40, [1e400], pd.DataFrame(), pd.Series([1.0]), IdealModel(), Ping.of(1.0),
    Reading.of(1.0), np.random.default_rng(0), Exception("x"),
)  # fmt: skip
MANY = ("bins", "num_envs", "distances", "count", "levels", "threads")  # numbers of which a large one takes long


class Calls(dict):
    """Calls by name, of which a failure shows no more than their number."""

    def __repr__(self):
        return f"<{len(self)} calls>"


@pytest.fixture(scope="module")
def valid_calls(tmp_path_factory):
    """Valid calls by name, in a folder of their own, where names without a folder are written."""
    folder, before = tmp_path_factory.mktemp("calls"), os.getcwd()
    os.chdir(folder)
    os.mkfifo("pipe")
    os.symlink("pipe", "link")
    yield Calls(calls(folder))
    assert stat.S_ISFIFO(os.stat("pipe").st_mode)
    assert Path("link").is_symlink()
    os.chdir(before)


def check_used_or_rejected(function, given_arguments):
    """Call a function; return the error of the project that it raises, if any."""
    with limited(given_arguments), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            function(**given_arguments)
        except SonarError as error:
            return str(error)
        except IndexError:
            assert function.__name__ == "__getitem__", given_arguments
    return None


def test_a_foreign_object_is_rejected_by_name(valid_calls):
    silent = []
    for name, (function, valid) in valid_calls.items():
        for argument in valid:
            message = check_used_or_rejected(function, {**valid, argument: FOREIGN})
            if message is None or argument.rstrip("_") not in message:
                silent.append((name, argument, message))
    silent = [each for each in silent if each[:2] not in UNCHECKED]
    assert not silent, silent


TREACHEROUS = {
    "a path that no system takes": Path("a" * 300),
    "a time, which is a whole number": np.timedelta64(1, "s"),
    "a file, which has no items": open(os.devnull, "w"),  # noqa: SIM115
    "a class of models": IdealModel,
    "a table, which has a to_dict": pd.Series([1.0, None]),
    "a generator of single numbers": random.Random(0),
    "more pings": Ping.of([1.0, 2.0, 3.0]),
    "a tensor with a gradient": torch.tensor([1.0], requires_grad=True),
    "a memory, which is a scalar": memoryview(b"abc"),
    "a range, which is endless in practice": range(10**15),
    "a range that is longer than a length can be": range(10**30),
}


@pytest.mark.parametrize("value", TREACHEROUS.values(), ids=TREACHEROUS)
def test_what_only_looks_right_is_used_or_rejected(valid_calls, value):
    for function, valid in valid_calls.values():
        for argument in valid:
            check_used_or_rejected(function, {**valid, argument: value})


@pytest.mark.parametrize(
    "use",
    [
        lambda endless: Ping.of(range(10**15)),
        lambda endless: Ping.of([1.0, 2.0])[range(10**15)],
        lambda endless: layout(endless),
        lambda endless: PhysicalModel(endless),
    ],
)
def test_more_than_fits_into_memory_is_rejected(use):
    with limited("endless"), pytest.raises(SonarError):
        use(itertools.repeat(None))


# a reward does not depend on `info`; what is indexed is named by its class
UNCHECKED = {("goal reward", "info"), ("Ping[]", "index")}


def wrong(rng):
    """Return something strange, or random numbers of any size, in an array of any shape."""
    number = rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-12, 300)
    shape = [rng.randrange(4) for _ in range(rng.randrange(4))]
    return rng.choice((*STRANGE, *STRANGE, number, round(number), np.full(shape, number), np.full(shape, np.nan)))


@FUZZ
@given(seed=st.integers(0, 2**32))
def test_a_wrong_argument_is_used_or_rejected(valid_calls, seed):
    rng = random.Random(seed)
    for _ in range(100):
        function, valid = valid_calls[rng.choice(list(valid_calls))]
        argument, value = rng.choice(list(valid)), wrong(rng)
        if not (argument in MANY and isinstance(value, int | float) and value > 64):
            check_used_or_rejected(function, {**valid, argument: value})
