"""Checks for structure that no per-reading model can represent: memory, drift, periods, coincident outliers."""
