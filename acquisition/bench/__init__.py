"""The waveform-level rig: recordings from geometry and electronics, sharing nothing with the laws it puts to test."""

from acquisition.bench.interference import Ambient, Neighbour
from acquisition.bench.registers import Registers
from acquisition.bench.rig import Rig
from acquisition.bench.setup import Bus, Post, Room, Scatterer, Setup
from acquisition.bench.shapes import MIRROR, RUBBER, Disc, Plate, Wall
from acquisition.bench.unit import Unit

__all__ = [
    "MIRROR",
    "RUBBER",
    "Ambient",
    "Bus",
    "Disc",
    "Neighbour",
    "Plate",
    "Post",
    "Registers",
    "Rig",
    "Room",
    "Scatterer",
    "Setup",
    "Unit",
    "Wall",
]
