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
        lead_unnamed: log-likelihood on unseen visits relative to a forest in its place, nats.
        lead_unnamed_error: standard error of it over visits, nats.
        share: its share of the misfit, 0 to 1.
        rest: share of the misfit that nothing explains, 0 to 1.
        lead: log posterior relative to the best alternative in its place, nats.
        prior: log prior of its size, nats, at most 0.
        p_before: p-value of the test of the simulation's law.
        p_after: p-value of the test of the corrected law.
        p_stable: p-value of the test that its size is the same everywhere.
        variation: by how much its size differs somewhere, relative to itself, 0 to 1.
        n_effects: number of selected effects.
        catch_all: whether it is an effect that many others resemble.
    """

    gain: float
    gain_error: float
    n_pings: int
    n_visits: int
    lead_unnamed: float
    lead_unnamed_error: float
    share: float
    rest: float
    lead: float
    prior: float
    p_before: float
    p_after: float
    p_stable: float
    variation: float
    n_effects: int
    catch_all: bool

    def features(self) -> Floats:
        """Return the features of the decision model.

        They are few, because wrong causes are few in an ensemble: by how many standard errors the effect predicts
        unseen visits better than nothing in its place, on a scale that tells 2 from 4 and not 40 from 42; whether it
        does better or worse than a forest, which describes any difference and names none, where more than a few
        standard errors say no more: with many readings under each condition a forest does as well as the truth;
        whether its size is the same everywhere, since what stands for something else acts in a part of the readings
        only; and whether the corrected law still differs.
        """
        t, lead = (
            value / error if error > 0.0 else 0.0
            for value, error in ((self.gain, self.gain_error), (self.lead_unnamed, self.lead_unnamed_error))
        )
        p = np.clip([self.p_stable, self.p_after], LEAST_P, 1.0)
        return np.array([np.log1p(np.clip(t, 0.0, MAX_T)), np.clip(lead, -CERTAIN, CERTAIN), *np.log10(p)])


MAX_T = 1e3  # standard errors; keeps the feature finite
CERTAIN = 3.0  # standard errors beyond which a lead is certain
LEAST_P = 5e-4  # of a test of 2,000 draws
FEATURES = ("log_t", "lead_t", "log_p_stable", "log_p_after")
