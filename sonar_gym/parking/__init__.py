"""The parking environments.

environment: one environment. vector: many environments. goal: a goal environment. fleet: the arrays of n worlds that
all share. step_kernel: one step, compiled. street: streets and the reference path. vehicle: the car. world: one world
for display. prior: credence given a reading. rendering: pictures. drawing: colours, camera and brush.
"""
