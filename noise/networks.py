"""Learned laws: networks from conditions to mixtures over what a register reads."""
