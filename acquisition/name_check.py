"""Whether the package that Python finds as `noise` is ours: PyPI has another distribution with that name."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from acquisition.errors import SonarError


class ForeignNoiseError(SonarError, ImportError):
    """Another distribution's `noise` stands in the place of ours."""


def check_noise() -> None:
    """Make sure that `import noise` gives this project's package, without importing it.

    Raises:
        ForeignNoiseError: it gives another one; the message says where that lies and what to do.
    """
    spec = find_spec("noise")
    origin = Path(spec.origin) if spec is not None and spec.origin else None
    if origin is None or not (origin.parent / "law.py").is_file():
        raise ForeignNoiseError(
            f"the package `noise` at {origin or 'nowhere'} is not the one of sonar-gym: "
            "run `pip uninstall noise`, then `pip install --force-reinstall --no-deps sonar-gym`"
        )
