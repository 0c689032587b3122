"""Sonars of other simulators: what they can hold of a model, and models of what they hold.

nearest: the normal law nearest to a model, and the error that it leaves. webots: lookup tables. gazebo: SDF sensors.
"""
