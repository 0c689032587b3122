"""Parts used by all stages: rules of belief, splits into parts, worker processes, predictions for unseen visits."""
