"""Sonars, scenes and odometry.

mounts: positions, cones and schedules of sonars.
scene: reflecting faces and cone casting.
kernels: geometry and motion, compiled.
sonar: random readings of a set of sonars, and their credence.
timing: period, phase and latency.
odometry: dead reckoning with errors.
"""
