from . import beam as beam
from . import credence as credence
from . import discrepancy as discrepancy
from . import effects as effects
from . import faults as faults
from . import fitting as fitting
from . import law as law
from . import learned as learned
from . import metrics as metrics
from . import model as model
from . import physical as physical
from . import rig as rig
from . import statistics as statistics
from . import store as store
from .composed import ComposedModel
from .credence import ConditionPrior, CredenceTable
from .discrepancy import diagnose
from .discrepancy.compose import compose
from .discrepancy.result import Diagnosis
from .effects import CATALOGUE
from .faults import Faulty
from .law import EchoLaw, ExtrapolationWarning
from .learned.networks import MlpModel
from .learned.recurrent import LstmModel
from .learned.thesis import load_thesis_network
from .model import GaussianModel, IdealModel, SonarModel, follow, listener, simulate
from .physical import PhysicalModel
from .replay import with_simulated
from .store import load_model, model_names, save_model

__version__: str
__all__ = [
    "CATALOGUE",
    "ComposedModel",
    "ConditionPrior",
    "CredenceTable",
    "Diagnosis",
    "EchoLaw",
    "ExtrapolationWarning",
    "Faulty",
    "GaussianModel",
    "IdealModel",
    "LstmModel",
    "MlpModel",
    "PhysicalModel",
    "SonarModel",
    "compose",
    "diagnose",
    "follow",
    "listener",
    "load_model",
    "load_thesis_network",
    "model_names",
    "save_model",
    "simulate",
    "with_simulated",
]
