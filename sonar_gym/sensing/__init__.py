"""Sonars in an environment, from their mounts to the observed readings.

kernels: compiled geometry and kinematics. mounts: positions, cones and timing of sonars. scene: reflecting faces and
the cones cast on them. sonar: a set of sonars with one model. timing: pings in flight and their arrival.
odometry: dead reckoning with errors.
"""
