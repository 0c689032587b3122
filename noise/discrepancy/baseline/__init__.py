"""The emulator: a law that describes the simulation."""
