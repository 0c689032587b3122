"""What a law is given of the paths of pings, and what it returns, as arrays."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from acquisition.arrays import Bytes, Floats, Ints
from noise.law import UniformSource


class PathPings(NamedTuple):
    """Paths as pings of a model, each as if it were alone in the cone.

    Attributes:
        conditions: distance, bearing, incidence, reflectance: m, rad, rad, 1, (4, m); covariates of the model in the
            order of its inputs may follow, NaN where missing.
        time: of the pings, s, (m,).
        places: place in the memory of the model, (m,): that of the sonar, and of the face if it remembers each by
            itself.
    """

    conditions: Floats
    time: Floats
    places: Ints


class PathDraws(NamedTuple):
    """Readings of m paths.

    Attributes:
        range: m, (m,); 0 without an echo.
        status: `EchoStatus`, (m,).
        credence: P(reading within 10 % of the distance), (m,); None if the model has no probabilities.
        fault: number of the model's fault that affects each reading, 0 for none, (m,); None if it has no faults.
    """

    range: Floats
    status: Bytes
    credence: Floats | None
    fault: Ints | None


class PathSource(UniformSource, Protocol):
    """A source of uniform random numbers for paths of several copies of a set of sonars."""

    def parts(self) -> Iterator[tuple[slice, UniformSource]]:
        """Yield the paths of each copy and a generator of its own, for laws that are sampled copy by copy."""
        ...


class PathLaw(ABC):
    """Draws readings of paths, with a memory if the model has one.

    Attributes:
        batched: whether several copies are sampled in one call.
        has_probabilities: whether there is a credence given the condition.
    """

    batched: bool = True
    has_probabilities: bool = True

    @abstractmethod
    def draw(self, pings: PathPings, source: PathSource) -> PathDraws:
        """Draw the readings of m paths."""

    def clear(self, places: Ints) -> None:  # noqa: B027 - most laws have no memory
        """Clear the memory at some places."""

    def hear(self, sonars: Ints, range_: Floats, status: Floats) -> None:  # noqa: B027
        """Note the readings of some sonars, of all their paths together, for laws that depend on the previous one."""
