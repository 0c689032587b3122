"""Settings of a recording on the rig.

- air: speed of sound, absorption, turbulence.
- interference: other sonars, moving objects, background noise, reverberation, hum.
- shapes: outlines of reflectors.
- unit: electronics of one SRF08.
- setup: the laboratory around it.
"""
