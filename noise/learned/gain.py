"""The gain of an SRF08 as a loss: how much weaker its comparator sees an echo than at the gain after power-up.

The amplifier's gain grows by one code every 70 us up to the cap in register 1 (Devantech, SRF08 manual), so that a cap
weakens the echoes that arrive after it is reached, by a known number of decibels, and changes nothing before.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acquisition import Ping
from acquisition.arrays import Floats
from acquisition.bench.acoustics.receiver import GAINS

GAIN, LOSS = "gain", "gain_loss_db"
POWER_UP = len(GAINS) - 1  # code
STEP_S, SOUND_MPS = 70e-6, 343.0  # time of a code; speed of sound, whose changes move a step by millimetres
_DECIBELS = 20.0 * np.log10(np.array(GAINS))


def gain_loss(gain: Floats, distance: Floats) -> Floats:
    """Return the loss of an echo by a cap of the gain, dB, (n,).

    Codes that do not exist count as 1 dB each, which is outside of what a law is trained with.

    >>> gain_loss(np.array([31.0, 14.0, 0.0, 0.0]), np.array([2.0, 2.0, 2.0, 0.01])).round(2)
    array([ 0.  , 16.19, 20.75,  0.  ])

    Args:
        gain: code of the cap, 0 to 31; NaN is that at power-up, (n,).
        distance: of the reflector, m, (n,).
    """
    cap = np.where(np.isnan(gain), POWER_UP, gain)
    reached = np.clip(np.floor(2.0 * distance / SOUND_MPS / STEP_S), 0, POWER_UP)
    codes = np.arange(len(GAINS))
    at_full, at_cap = (np.interp(code, codes, _DECIBELS) for code in (reached, np.minimum(reached, cap)))
    beyond = cap - np.clip(cap, 0, POWER_UP)
    return at_full - at_cap - beyond


def with_loss(ping: Ping) -> Ping:
    """Return pings with the loss by their gain as a covariate; without a gain, it is that at power-up."""
    gain = ping.covariates.get(GAIN)
    loss = np.zeros(len(ping)) if gain is None else gain_loss(gain, ping.distance)
    return replace(ping, covariates={**ping.covariates, LOSS: loss})
