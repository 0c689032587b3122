"""Sonars in an environment, from their mounts to the observed readings.

kernels: compiled geometry and kinematics. mounts: positions, cones and timing of sonars. scene: reflecting faces and
the cones cast on them. paths: the reflectors in a cone. detection: which of them a model hears. crosstalk: bursts of
other sonars. persistence: errors that persist. laws: compiled sampling of models. sonar: a set of sonars with one
model. records: the first echo of a ping, pings in flight and what is shown of them. pipeline: all of these in turn.
timing: when sonars ping. odometry: dead reckoning with errors.
"""
