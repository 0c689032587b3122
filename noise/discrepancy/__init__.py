"""Diagnosis: where a simulation and a recording differ, why, by how much, and the corrected model."""
