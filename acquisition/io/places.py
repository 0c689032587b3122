"""Where results may be written: checked before a command starts its work, so that no work is lost."""

from __future__ import annotations

import os
import stat
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from acquisition.errors import SettingError
from acquisition.limits import hints_of

RESULTS = ("model.json", "verdict.json", "agent.json", "ledger.jsonl")  # files that make a folder a result


@dataclass(frozen=True)
class Output:
    """Marks the annotation of a path that is written.

    Attributes:
        kind: as a file or as a folder.
        result: file by which the folder is known as this command's own result, one of `RESULTS`; "" for none.
    """

    kind: Literal["file", "folder"]
    result: str = ""


OutputFile = Annotated[Path, Output("file")]
OutputFolder = Annotated[Path, Output("folder")]


def check_places(settings: Any) -> None:
    """Check the paths of a dataclass whose annotations say that they are written.

    Raises:
        SettingError: see `check_output`.
    """
    cls: type = type(settings)
    for field, hint in hints_of(cls):
        for part in (hint, *get_args(hint)):
            mark = next((extra for extra in get_args(part) if isinstance(extra, Output)), None)
            if get_origin(part) is Annotated and mark is not None and getattr(settings, field) is not None:
                check_output(getattr(settings, field), mark.kind, _option(field), mark.result)
                _check_others(settings, field)


def _option(field: str) -> str:
    return f"--{field.replace('_', '-')}"


def _is_same(path: Path, other: Path) -> bool:
    try:
        return path.is_file() and path.samefile(other)
    except (OSError, ValueError):  # there is no other, or its name cannot be that of a file
        return False


def _check_others(settings: Any, field: str) -> None:
    """Check that what is written is none of the other files of the settings, which would be lost."""
    path: Path = getattr(settings, field)
    cls: type = type(settings)
    for other, _ in hints_of(cls):
        value = getattr(settings, other)
        if other != field and isinstance(value, Path) and _is_same(path, value):
            raise SettingError(f"{_option(field)} {path}: is also {_option(other)}; give another path")


def check_output(path: Path, kind: Literal["file", "folder"], name: str = "--out", result: str = "") -> None:
    """Check that a file or folder can be written.

    Args:
        path: of the file or folder; it need not exist.
        kind: which of them.
        name: of the setting, for messages.
        result: file of an earlier result that the command may continue or replace.

    Raises:
        SettingError: it is a link to nothing, of the other kind, below a file, not writable, or in another result.
    """
    try:
        if "\0" in str(path):
            raise SettingError(f"{name} {path}: contains a null character; give another path")
        path = Path(os.path.abspath(path))
        _check_itself(path, kind, name)
        _check_parents(path, kind, name)
        if kind == "folder":
            _check_results(path, name, result)
    except SettingError:
        raise
    except (OSError, ValueError) as error:  # a name that is too long, or a null character
        raise SettingError(f"{name} {path}: {getattr(error, 'strerror', error)}; give another path") from None


def _check_itself(path: Path, kind: str, name: str) -> None:
    if path.is_symlink() and not path.exists():
        raise SettingError(f"{name} {path}: is a link to nothing; remove it or give another path")
    mode = path.stat().st_mode if path.exists() else None
    if mode is None:
        return
    if kind == "folder" and not stat.S_ISDIR(mode):
        raise SettingError(f"{name} {path}: is a file, expected a folder; give another name")
    if kind == "file" and stat.S_ISDIR(mode):
        raise SettingError(f"{name} {path}: is a folder, expected a file; give the name of a file in it")
    if kind == "file" and not stat.S_ISREG(mode):
        raise SettingError(f"{name} {path}: is a device or a pipe, expected a file on a disk; give another path")
    if kind == "file" and not os.access(path, os.W_OK):
        raise SettingError(f"{name} {path}: is read-only; give another path, or make it writable")


def _check_parents(path: Path, kind: str, name: str) -> None:
    parents = list(path.parents)
    nearest = path if kind == "folder" and path.exists() else next(p for p in parents if p.exists())
    if not nearest.is_dir():
        raise SettingError(f"{name} {path}: {nearest} is a file; give a path below a folder")
    try:
        tempfile.TemporaryFile(dir=nearest).close()  # permissions alone do not say whether a disk can be written
    except OSError as error:
        raise SettingError(f"{name} {path}: {nearest} cannot be written: {error.strerror}; give another path") from None


def _check_results(path: Path, name: str, own: str) -> None:
    found = [file for file in RESULTS if file != own and (path / file).is_file()]
    if found:
        raise SettingError(f"{name} {path}: is a result of another kind (it holds {found[0]}); give another folder")
    around = [parent for parent in list(path.parents)[:2] if any((parent / file).is_file() for file in RESULTS)]
    if around:
        raise SettingError(f"{name} {path}: lies inside the result {around[0]}; give a folder beside it")
