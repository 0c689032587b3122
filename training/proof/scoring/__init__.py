"""Scores of trials, baselines, and the published page."""
