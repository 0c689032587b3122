"""Every number that steers a verdict, with its reason. Everything else that decides is fitted on generated trials."""

from __future__ import annotations

FALSE_ALARM = 0.01  # probability of a false difference between two recordings of one sonar
BIAS_TOLERANCE_M = 0.002  # two recordings of one sonar differ by this much: placement with a ruler
SHARE_TOLERANCE = 0.02  # of pings: two recordings of one sonar differ by this much in echoes heard
BELIEVED = 0.5  # probability from which an effect is reported as a cause: it is then more likely true than not
MIN_SHARE = 0.03  # share of the misfit below which a second effect is not reported beside others
EXPLAINED_SHARE = 0.9  # share from which causes explain the difference
PARTLY_SHARE = 0.3  # share from which they explain a part of it
MAX_CAUSES = 6  # a simulation that lacks more than this should be replaced, not corrected
LISTED = 0.05  # probability from which an alternative is listed
