"""Diagnosis: where a simulation and a recording differ, why, by how much, and the corrected model."""

from noise.discrepancy.diagnose import diagnose
from noise.discrepancy.result import Aspect, Cause, Diagnosis, Kind, Verdict

__all__ = ["Aspect", "Cause", "Diagnosis", "Kind", "Verdict", "diagnose"]
