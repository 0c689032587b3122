"""Development trials of the diagnosis: causes concealed in recordings of the rig, and the table of what was said."""
