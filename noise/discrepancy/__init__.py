"""Where a model and a recording differ, what was left out, and the model corrected."""
