"""The version of the distribution that is installed."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("sonar-gym")
except PackageNotFoundError:  # a checkout that is not installed
    __version__ = "0+unknown"
