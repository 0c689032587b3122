"""What is known of a selected effect when it is judged, as features of the decision model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.arrays import Floats


@dataclass(frozen=True)
class Evidence:
    """What is known of a selected effect when it is judged.

    Attributes:
        gain: log-likelihood on unseen visits that is lost without it, nats.
        gain_error: standard error of `gain` over visits, nats.
        n_pings: number of pings of the folds.
        n_visits: number of visits of the folds.
        share: its share of the misfit, 0 to 1.
        rest: share of the misfit that nothing explains, 0 to 1.
        lead: log posterior relative to the best alternative in its place, nats.
        prior: log prior of its size, nats, at most 0.
        p_before: p-value of the test of the simulation's law.
        p_after: p-value of the test of the corrected law.
        n_effects: number of selected effects.
        catch_all: whether it is an effect that many others resemble.
    """

    gain: float
    gain_error: float
    n_pings: int
    n_visits: int
    share: float
    rest: float
    lead: float
    prior: float
    p_before: float
    p_after: float
    n_effects: int
    catch_all: bool

    def features(self) -> Floats:
        """Return the features of the decision model, on scales on which a unit matters."""
        return np.array(
            [
                np.log1p(max(self.gain, 0.0)),
                np.clip(self.gain / max(self.gain_error, 1e-9), -3.0, 12.0),
                np.log10(max(self.gain, 1e-3) / self.n_pings),
                self.share,
                self.rest,
                np.tanh(self.lead / 10.0),
                self.prior,
                np.log10(max(self.p_before, 1e-4)),
                np.log10(max(self.p_after, 1e-4)),
                float(self.n_effects - 1),
                float(self.catch_all),
                np.log10(self.n_visits),
            ]
        )


FEATURES = (
    "log_gain",
    "gain_in_errors",
    "log10_gain_per_ping",
    "share",
    "rest",
    "lead",
    "prior",
    "log10_p_before",
    "log10_p_after",
    "other_effects",
    "catch_all",
    "log10_visits",
)
