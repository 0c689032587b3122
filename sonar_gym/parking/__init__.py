"""The parking environments.

environment: one environment. vector: many environments. goal: a goal environment. fleet: the arrays of n worlds that
all share. step_kernel: one step, compiled. cost_to_go: the shortest way into a space. street: streets and the reference
path. obstacles: what else stands or moves in a street. randomization: what else episodes draw. vehicle: the car. world:
one world for display. prior: credence given a reading. stored: its tables on disk. rendering: pictures. drawing:
colours, camera and brush.
"""
