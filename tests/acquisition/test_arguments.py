"""Arguments of public functions are checked against their annotations."""

from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
from numpy.typing import ArrayLike

from acquisition import Ping, SettingError
from acquisition.arguments import checked
from acquisition.arrays import Floats, Ints
from acquisition.limits import Limit, check_value


@checked
def listen(
    ping: Ping,
    path: Path | str,
    gain: Annotated[int, Limit(0, 31)] = 0,
    names: Mapping[str, int] | None = None,
    times: np.ndarray | None = None,
    ranges: Floats | None = None,
    runs: Ints | None = None,
    errors: Sequence[Exception] = (),
    places: ArrayLike = 0,
    **more: float,
) -> int:
    """Return the gain."""
    return gain


PING = Ping.of(1.0)


def test_what_fits_passes_by_place_and_by_name():
    assert listen(PING, "a", 3, {"a": 1}, [1.0], other=2) == 3
    assert listen(ping=PING, path=Path("a"), gain=np.int64(31), names=None) == 31
    assert listen(PING, "a", places=1, ranges=1, runs=[1.0], errors=iter([ValueError()])) == 0
    assert listen.__doc__ == "Return the gain."


def test_what_is_annotated_becomes_an_array_or_a_tuple():
    @checked
    def given(ranges: Floats, runs: Ints, errors: Iterable[Exception], width: float) -> tuple[object, ...]:
        return ranges, runs, errors, width

    ranges, runs, errors, width = given([1, 2], [3.0], (error for error in [KeyError()]), np.int64(1))
    assert (ranges.dtype, runs.dtype, type(errors), type(width)) == (np.float64, np.int64, tuple, float)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"ping": 1.0}, "listen.ping: expected Ping, got 1"),
        ({"path": b"a"}, "listen.path: expected Path or str, got b'a'"),
        ({"gain": 32}, "listen.gain: expected a whole number from 0 to 31, got 32"),
        ({"gain": "x"}, "listen.gain: expected a whole number from 0 to 31, got 'x'"),
        ({"gain": True}, "listen.gain: expected a whole number from 0 to 31, got True"),
        ({"ranges": "x"}, "listen.ranges: expected numbers, got 'x'"),
        ({"runs": [0.5]}, "listen.runs: expected whole numbers, got array"),
        ({"errors": [1]}, "listen.errors: expected a list of Exception, got 1 in it"),
        ({"errors": 1}, "listen.errors: expected a list of Exception, got 1 in it"),
        ({"names": [1]}, r"listen.names: expected Mapping or None, got \[1\]"),
    ],
)
def test_what_does_not_fit_is_named(given, message):
    with pytest.raises(SettingError, match=message):
        listen(**{"ping": PING, "path": "a", **given})
    default = {"times": None, "ranges": None, "runs": None, "errors": ()}
    by_place = {"ping": PING, "path": "a", "gain": 0, "names": None, **default, **given}
    with pytest.raises(SettingError, match=message):
        listen(*by_place.values())


@pytest.mark.parametrize("number", [Fraction(1, 3), Decimal("0.5"), np.True_, 1j])
def test_a_number_that_compiled_code_does_not_know_is_rejected(number):
    with pytest.raises(SettingError, match="x: expected a finite number, got"):
        check_value("x", number, float)
    for known in (1, 0.5, np.float32(0.5), np.uint8(3)):
        check_value("x", known, float)


@pytest.mark.parametrize("hint", [int | None, bool, Literal["a"], tuple[float, ...]])
def test_a_path_stands_for_no_number_and_no_choice(hint):
    with pytest.raises(SettingError, match=r"^seed: expected .*got "):
        check_value("seed", Path("a"), hint)
