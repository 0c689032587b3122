"""Waveform-level simulation of an SRF08 in a laboratory, independent of the noise models that it is used to test.

- rig: fire pings and return registers or a recording.
- visits: grouping of pings into visits and segments of constant air.
- reception: received waveforms and echo times of a batch of pings.
- disturbances: sound that does not come from the ping itself.
- firmware, registers: from threshold crossings to register contents and ranges.
- wire: bus faults.
- laboratory: settings of the laboratory, its air and reflectors, and of one sensor.
- acoustics: sound paths, transducers and the comparator.
"""

from acquisition.bench.laboratory.air import Gradient
from acquisition.bench.laboratory.interference import Ambient, Hum, Mover, Neighbour, Reverberation
from acquisition.bench.laboratory.setup import Bus, Post, Room, Scatterer, Setup
from acquisition.bench.laboratory.shapes import MIRROR, RUBBER, Disc, Plate, Wall
from acquisition.bench.laboratory.unit import Unit
from acquisition.bench.registers import Registers, TrueEchoes
from acquisition.bench.rig import Rig

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
    "TrueEchoes",
    "Unit",
    "Wall",
]
