"""Naming: the effects in which a recording differs from its simulation, their alternatives and their sizes."""
