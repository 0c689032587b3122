"""Check that `import noise` finds the package of this project; PyPI has another distribution of that name."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from acquisition.errors import SonarError


class ForeignNoiseError(SonarError, ImportError):
    """`import noise` finds a package of another distribution."""


def check_noise() -> None:
    """Check that `import noise` would import the package of this project, without importing it.

    Raises:
        ForeignNoiseError: it would import another package; the message gives its path and the remedy.
    """
    spec = find_spec("noise")
    origin = Path(spec.origin) if spec is not None and spec.origin else None
    if origin is None or not (origin.parent / "law.py").is_file():
        raise ForeignNoiseError(
            f"the package `noise` at {origin or 'nowhere'} is not the package of sonar-gym: "
            "run `pip uninstall noise`, then `pip install --force-reinstall --no-deps sonar-gym`"
        )
