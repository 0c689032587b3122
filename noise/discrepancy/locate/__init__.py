"""Where simulation and recording differ: the tests, regions, and their power."""
