"""The law that describes the simulation, and what readings show beyond a law.

emulator: a physical law with a smooth correction, fitted to readings. sources: the simulation as a model, a file, or a
function that is asked. forest: readings under similar conditions and after a similar past, from trees (similarity);
forest_law: their law. adjusted: a law corrected by sums of trees. transport: readings carried from law to law.
"""
