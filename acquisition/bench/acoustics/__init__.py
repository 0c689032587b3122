"""Acoustics of the rig.

- air: speed of sound, absorption, turbulence.
- shapes: outlines of reflectors.
- transducer: pulse shape and beam pattern.
- arrivals: echo paths with length and amplitude.
- geometry: paths between the sensor and a reflector.
- room: paths by way of the stand, walls, floor, clutter.
- interference: other sonars, moving objects, background noise, reverberation, hum.
- receiver: waveforms and comparator.
"""
