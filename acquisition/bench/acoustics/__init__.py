"""Acoustics of the rig.

- transducer: pulse shape and beam pattern.
- arrivals: echo paths with length and amplitude.
- geometry: paths between the sensor and a reflector.
- room: paths by way of the stand, walls, floor, clutter.
- receiver: waveforms and comparator.
"""
