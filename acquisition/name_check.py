"""Check that `import noise` and the like find the packages of this project, and nothing else of that name."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from acquisition.errors import SonarError

# package -> a module that no other package of that name has
OURS = {"noise": "law.py", "sonar_gym": "wrappers", "training": "cli.py"}
THEIRS = (  # packages of others that this project needs; each is a folder, so a file of that name is the user's
    "gymnasium", "matplotlib", "numba", "numpy", "pandas", "pydantic", "rich", "scipy", "stable_baselines3", "torch",
    "tyro",
)  # fmt: skip


class ForeignNameError(SonarError, ImportError):
    """A package of this project is shadowed by a file or by a package of another distribution."""


def check_names(*names: str) -> None:
    """Check that packages of this project would be imported under their names, without importing them.

    Args:
        names: of `OURS`; all by default.

    Raises:
        ForeignNameError: another file or package would be; the message gives its path and the remedy.
    """
    for name in names or OURS:
        spec, member = find_spec(name), OURS[name]
        origin = Path(spec.origin) if spec is not None and spec.origin else None
        if origin is None or not (origin.parent / member).exists() or origin.name != "__init__.py":
            raise ForeignNameError(
                f"`import {name}` finds {origin or 'nothing'}, not sonar-gym: {remedy(name, origin)}"
            )


def foreign() -> str | None:
    """Return what to do about a file of the user's that shadows a package of `THEIRS`; None if there is none."""
    specs = [spec for spec in map(find_spec, THEIRS) if spec is not None]
    found = next((spec for spec in specs if spec.submodule_search_locations is None), None)
    if found is None:
        return None
    return f"`import {found.name}` finds {found.origin}, not the package {found.name}: {renamed(found.origin)}"


def remedy(name: str, origin: Path | None) -> str:
    """Return what to do about a package that shadows one of this project."""
    if origin is not None and "site-packages" not in origin.parts:
        found = origin if origin.name != "__init__.py" else origin.parent
        return renamed(found)
    uninstall = "" if origin is None else f"run `pip uninstall {name}`, then "
    return f"{uninstall}`pip install --force-reinstall --no-deps sonar-gym`"


def renamed(path: Path | str | None) -> str:
    """Return what to do about a file or a folder of the user's."""
    return f"rename {path}, since Python finds it first"
