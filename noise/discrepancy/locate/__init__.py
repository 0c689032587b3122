"""Where simulation and recording differ: scores, the orthogonal test, regions, and its power."""
