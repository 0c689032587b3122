"""Laws of sonar readings: physical, learned and corrected models, and the diagnosis of discrepancies.

Names are imported on first use (`__init__.pyi` lists them), so that torch is loaded only by a model that needs it.

law: the law of a ping, `EchoLaw`. model: protocols, simulation, ideal and Gaussian models. physical: effects on an
ideal sonar. beam: the beam model of Thrun et al. faults: faults on any model. composed: a learned law with the causes
of a diagnosis. replay: a simulator's own readings as a model. rig: the waveform rig as a model. table: normal readings
by a table over distance. store: load and save. metrics: scores. credence: credence given a reading. statistics: robust
estimates. effects: the catalogue of effects. learned: networks. fitting: maximum likelihood. discrepancy: diagnosis.
"""

import lazy_loader as lazy

import acquisition

if not hasattr(acquisition, "SonarError"):  # said here, since nothing of the package that is hidden can say it
    raise ImportError(
        f"`import acquisition` finds {acquisition.__file__}, not sonar-gym: rename it, since Python finds it first"
    )
from acquisition.extras import require
from acquisition.version import __version__ as __version__

require("scipy", "noise")
__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
