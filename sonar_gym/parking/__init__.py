"""The parking environments.

environment: one environment. vector: many environments. goal: a goal environment. fleet: the arrays of n worlds that
all share. step_kernel: one step, compiled. world: one world for display. prior: credence given a reading. stored: its
tables on disk. settings: the keywords of an environment. rendering: pictures. drawing: colours, camera and brush.
"""
