"""Every number that steers a verdict, with its reason. Everything else that decides is fitted on generated trials."""

from __future__ import annotations

FALSE_ALARM = 0.01  # probability of a false difference between two recordings of one sonar
BIAS_TOLERANCE_M = 0.002  # two recordings of one sonar differ by this much: placement with a ruler
MAX_PLACEMENT_M = 0.005  # ruler and mount scatter by 1 to 5 mm: more is a difference, and no lack of care
SHARE_TOLERANCE = 0.02  # of pings: two recordings of one sonar differ by this much in echoes heard
BELIEVED = 0.5  # probability from which an effect or one of its alternatives is reported as a cause
FIRST_GAIN = 3.0  # nats that the first effect must gain: odds of 20 to 1, since the test has found a difference before
MIN_SHARE = 0.03  # share of what is explained below which a further effect is not sought beside others
EXPLAINED_SHARE = 0.9  # share from which causes explain the difference
PARTLY_SHARE = 0.3  # share from which they explain a part of it
MAX_CAUSES = 6  # a simulation that lacks more than this should be replaced, not corrected
LISTED = 0.05  # probability from which an alternative is listed
SPREAD_TOLERANCE = 0.2  # relative change of the scatter: two sensors of one type differ by this much; chosen here
LEAST_VISIBLE_M = 0.1  # a recording that shows no smaller bias says nothing: no sonar errs by more
LEAST_VISIBLE_SHARE = 0.5  # a recording that shows no smaller loss of echoes says nothing
LEFT_LEVEL = 0.1  # of the test after each cause: a further search costs time, and the gain of a cause decides
MOVED_SHARE = 0.25  # of a size, by which matching both files may move it; farther, statistics are not linear in it
LEAST_CHANCE = 1e-6  # no test of readings is surer: the file itself may be wrong
