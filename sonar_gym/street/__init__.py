"""Streets to park in.

street: streets and the reference path. obstacles: what else stands or moves in a street. vehicle: the car. cost_to_go:
the shortest way into a space. randomization: what else episodes draw.
"""
