"""An SRF08 twin with its driver."""

import numpy as np

from acquisition.bench import Rig, Setup, Unit
from acquisition.drivers import Srf08
from acquisition.twins.devantech import BadWire, Srf08Twin

QUIET = Setup(placement_m=0.0, placement_deg=0.0, tilt_deg=0.0, drift_c=0.0, post=None)


def pair(wire=None, setup=QUIET, **settings):
    twin = Srf08Twin(Rig(Unit.nominal(), setup), np.random.default_rng(0), wire=wire or BadWire())
    settings = {"gain": 20, "range_register": 140, **settings}
    return twin, Srf08(twin, sleep=twin.clock.sleep, clock=twin.clock, **settings)
