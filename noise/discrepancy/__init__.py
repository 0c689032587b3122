"""Diagnosis: where a simulation and a recording differ, why, by how much, and the corrected model."""

from noise.discrepancy.diagnosis import Diagnosis, diagnose
from noise.discrepancy.judge.verdict import VERDICTS, Verdict

__all__ = ["VERDICTS", "Diagnosis", "Verdict", "diagnose"]
