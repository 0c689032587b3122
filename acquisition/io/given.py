"""What is accepted where a recording is expected: a recording, a table, or the path of a CSV file."""

from __future__ import annotations

import os
from typing import TypeAlias

import pandas as pd

from acquisition.errors import SettingError
from acquisition.io.recording import Recording
from acquisition.limits import check_value

RecordingLike: TypeAlias = Recording | pd.DataFrame | str | os.PathLike[str]


def as_recording(given: RecordingLike, name: str = "recording") -> Recording:
    """Return a recording given as such, as a table, or by the path of a CSV file.

    Args:
        given: recording, table with the columns of the recording format, or path.
        name: name of a table, for messages.

    Raises:
        RecordingError: a column is missing or a value violates the format.
        SettingError: of another type.
    """
    check_value("as_recording.name", name, str)
    if isinstance(given, Recording):
        return given
    if isinstance(given, pd.DataFrame):
        text = given.reset_index(drop=True).set_axis(list(map(str, given.columns)), axis=1).astype(object)
        return Recording.from_text(text.where(given.notna().to_numpy(), "").astype(str), name)
    if isinstance(given, str | os.PathLike):
        return Recording.load(given)
    raise SettingError(
        f"{name}: is a {type(given).__name__}, expected a Recording, a DataFrame or the path of a CSV file"
    )
