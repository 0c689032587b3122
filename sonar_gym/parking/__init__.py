"""The environment SonarParking-v0.

environment: one environment. vector: many environments. fleet: the arrays of n worlds that both share. step_kernel: one
step, compiled. street: streets and the reference path. vehicle: the car. world: one world for display. prior: credence
given a reading. rendering: pictures. drawing: colours, camera and brush.
"""
