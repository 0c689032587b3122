"""The waveform-level rig: recordings from geometry and electronics, sharing nothing with the laws it puts to test."""

from acquisition.bench.acoustics.air import Gradient
from acquisition.bench.acoustics.interference import Ambient, Hum, Mover, Neighbour, Reverberation
from acquisition.bench.acoustics.shapes import MIRROR, RUBBER, Disc, Plate, Wall
from acquisition.bench.registers import Registers, Truth
from acquisition.bench.rig import Rig
from acquisition.bench.setup import Bus, Post, Room, Scatterer, Setup
from acquisition.bench.unit import Unit

__all__ = [
    "MIRROR",
    "RUBBER",
    "Ambient",
    "Bus",
    "Disc",
    "Gradient",
    "Hum",
    "Mover",
    "Neighbour",
    "Plate",
    "Post",
    "Registers",
    "Reverberation",
    "Rig",
    "Room",
    "Scatterer",
    "Setup",
    "Truth",
    "Unit",
    "Wall",
]
