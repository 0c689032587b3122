"""A diagnosis in words and as HTML fragments; figures and pages are drawn by `training.diagnosis`."""
