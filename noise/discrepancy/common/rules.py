"""When an effect is believed, and the record of what was tried."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Floats
from noise.effects import CATALOGUE
from noise.fitting.stack import JITTER

SURE = 30.0  # nats, beyond which an effect is believed although cells that both files share show no difference; ours
SURE_OF_AIR = 100.0  # the same of livelier air that nothing is located by: a law's misfit of levels passes for it; ours
TIE = 3.0  # nats observed: less does not exclude anything
AIR = {JITTER: SURE, "scintillation": SURE_OF_AIR}  # what another day changes by itself, by less than so many nats


@dataclass(frozen=True)
class Rules:
    """When an effect is believed, and how much work goes into the search.

    Attributes:
        least_nats: cross-fitted gain below which nothing is added.
        least_t: the same in standard errors over blocks.
        sweeping_nats, sweeping_t: gain beyond which so many standard errors are enough of an effect that strikes: what
            is plain in a few cells and absent from all others is many nats and few standard errors.
        keep_nats: cross-fitted loss below which a chosen effect is dropped again.
        bounded_nats: of each block at most, where the standard error is taken a second time: one heavy block
            then neither makes nor breaks a case.
        tie_nats: a simpler effect is preferred to one that gains no more than this, or one standard error, beyond it.
        most_effects: at most so many are added.
        grid_pings, screen_pings, full_pings: sizes of the batches for the three grades of fit.
        fitted: candidates that are fitted after the grid.
        crossed: of those, the ones that are cross-fitted.
        rivals: effects that are tried in the place of each chosen one.
    """

    least_nats: float = 6.0
    least_t: float = 2.0
    sweeping_nats: float = 30.0
    sweeping_t: float = 2.5
    keep_nats: float = 2.0
    bounded_nats: float = 2.0
    tie_nats: float = 4.0
    most_effects: int = 4
    grid_pings: int = 400
    screen_pings: int = 1200
    full_pings: int = 2500
    fitted: int = 10
    crossed: int = 4
    rivals: int = 6

    def believes(self, name: str, gain: Floats, first: bool = False) -> bool:
        """Tell whether an effect's gains by block are more than chance, and not the work of one block.

        Of the first effect alone it is enough if bounded gains say so: what follows it leans on what it left over.
        """
        total, enough, most = gain.sum(), self.least_nats, self.bounded_nats
        without_best = total - gain.max(initial=0.0)
        looks = (gain, np.clip(gain, -most, most)) if first else (gain,)
        sweeping = total >= self.sweeping_nats and CATALOGUE[name].localised
        least_t = min(self.sweeping_t, self.least_t) if sweeping else self.least_t
        sure = any(g.sum() > least_t * spread_over_blocks(g) for g in looks)
        return bool(total > enough and sure and without_best > 0.3 * enough)


@dataclass(frozen=True)
class Attempt:
    """What was tried: an effect, given others, and what it gained.

    Attributes:
        effect: id.
        given: effects already chosen.
        screen_nats: gain where it was fitted.
        gain_nats, gain_se: cross-fitted gain and its standard error over blocks; nan where it was not worth it.
        decision: in words.
    """

    effect: str
    given: tuple[str, ...]
    screen_nats: float
    gain_nats: float = np.nan
    gain_se: float = np.nan
    decision: str = "did not come near"


def spread_over_blocks(gain: Floats) -> float:
    """Return the standard error of a sum of block gains."""
    return float(np.sqrt(np.sum((gain - gain.mean()) ** 2))) if len(gain) > 1 else 0.0
