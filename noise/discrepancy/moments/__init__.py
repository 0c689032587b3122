"""Moments of both files: scores under a law, less what the law gets wrong for both, and their distribution."""
