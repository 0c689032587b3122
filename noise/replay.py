"""The readings of a simulator as a model, so that the differences of a diagnosis act on them and not on a law of them.

The simulator's reading of each ping, and the one before it, stand beside its condition, in the columns `SIMULATED` and
`SIMULATED_BEFORE`. Where the simulator heard an echo, the law is certain of its step of the register. Where it heard
none, an echo that the differences make audible has the range that another law expects.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import EchoStatus, Ping, Reading, Recording, previous
from acquisition.arguments import checked
from acquisition.arrays import Bits, Floats
from acquisition.io.recording import MM
from acquisition.ping import check_pairs
from noise.law import EchoLaw
from noise.model import SonarModel, simulate

SIMULATED = ("simulated_range_m", "simulated_status")
SIMULATED_BEFORE = ("simulated_range_before_m", "simulated_status_before")
RARE = 1e-9  # stands for the probability of an echo where the simulator heard none; only its ranges matter


@checked
def with_simulated(ping: Ping, simulated: Reading, before: Reading | None = None) -> Ping:
    """Return pings with the readings of a simulator, (n,), in the columns `SIMULATED` and `SIMULATED_BEFORE`.

    Args:
        ping: conditions, (n,), in chronological order within each run.
        simulated: readings of the simulator, (n,).
        before: its reading before each of them, (n,); by default that of the ping before in the same run.
    """
    check_pairs("simulated", ping, simulated)
    before = previous(simulated, ping.run) if before is None else before
    check_pairs("before", ping, before)
    pairs = ((SIMULATED, simulated), (SIMULATED_BEFORE, before))
    columns = {name: value for names, each in pairs for name, value in zip(names, _values(each), strict=True)}
    return replace(ping, covariates={**ping.covariates, **columns})


def _values(reading: Reading) -> tuple[Floats, Floats]:
    return reading.range, reading.status.astype(np.float64)


def given_readings(ping: Ping, names: tuple[str, str] = SIMULATED) -> Reading | None:
    """Return the simulator's readings that stand beside n pings, (n,); None where there are none."""
    if not set(names) <= ping.covariates.keys():
        return None
    range_, status = (ping.covariates[name] for name in names)
    return Reading.of(range_, status.astype(np.uint8))


class ReplayLaw(EchoLaw):
    """Given readings.

    Attributes:
        given: readings, (n,).
        given_step: of the given readings, m: an exact range lies anywhere within one.
        other: law of the ranges where no echo was given.
    """

    uniform_per_ping = True

    def __init__(self, given: Reading, given_step: float, other: EchoLaw, resolution: float) -> None:
        super().__init__(other.distance, resolution, other.max_range)
        self.given, self.given_step, self.other = given, given_step, other
        echo = other.echo
        # divided by a smaller number, it would overflow
        self._rare = np.divide(RARE, echo, out=np.zeros_like(echo), where=echo >= np.finfo(np.float64).tiny)

    def _arrival(self, z: Floats) -> Floats:
        within = np.clip((z - self.given.range) / self.given_step + 0.5, 0.0, 1.0)
        return np.where(self.given.echo, within, self._rare * self.other.arrival(z))

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer): 1 where the simulator gave no answer, (n,)."""
        return (self.given.status == EchoStatus.NO_ANSWER).astype(np.float64)

    @property
    def extrapolates(self) -> Bits:
        """Whether the range is that of the other law, and it extrapolates, (n,)."""
        return np.asarray(~self.given.echo & self.other.extrapolates)


@dataclass(frozen=True)
class Replay:
    """A simulator whose reading of each ping stands beside the condition; without one, another model.

    Args:
        other: model of the simulator, for pings without its reading and for ranges where it heard no echo.
        step: of the simulator's register, m.
        resolution: step of the register that is modelled, m.
    """

    other: SonarModel
    step: float
    resolution: float

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading."""
        return self.other.remembers

    @checked
    def law(self, ping: Ping, past: Reading | None = None) -> EchoLaw:
        """Return the law of n pings; that of the other model where no reading of the simulator is given."""
        given, other = given_readings(ping), self.other.law(ping, past)
        return other if given is None else ReplayLaw(given, self.step, other, self.resolution)

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data."""
        other: Any = self.other
        return {"kind": "replay", "other": other.to_dict(), "step": self.step, "resolution": self.resolution}

    @classmethod
    @checked
    def load(cls, folder: Path, data: dict[str, Any], load_kind: Callable[[Path, object], SonarModel]) -> Replay:
        """Load a saved model; `load_kind` loads the other model."""
        return cls(load_kind(folder, data["other"]), float(data["step"]), float(data["resolution"]))


@checked
def corrected_readings(model: SonarModel, simulated: Recording, rng: np.random.Generator) -> Recording:
    """Return a simulator's recording with differences applied to its readings; further echoes are left out.

    Args:
        model: the differences, as `Diagnosis.difference` or its folder has them.
        simulated: the simulator's readings.
        rng: random generator.
    """
    reading = simulate(model, with_simulated(simulated.ping, simulated.reading), rng)
    echoes = [name for name in simulated.table.columns if re.fullmatch(r"echo_\d+_mm", name)]
    value = np.where(reading.answered, reading.range / MM, np.nan)
    return replace(simulated, table=simulated.table.drop(columns=echoes).assign(reading_mm=value.round(6)))
