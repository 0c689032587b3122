"""Commands: training, diagnosis, demonstrations. Imported by nothing."""
