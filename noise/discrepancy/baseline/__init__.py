"""The law that describes the simulation.

emulator: a physical law with a smooth correction, fitted to readings; the empirical term of a recording.
sources: the simulation as a model, a file, or a function that is asked. forest: readings under
similar conditions and after a similar past, from trees; forest_law: their law.
"""
