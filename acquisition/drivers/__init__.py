"""The sensor drivers and their twins."""
