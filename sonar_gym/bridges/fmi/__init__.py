"""A unit of FMI 3.0 for co-simulation.

build: writes it. sonar_gym_unit: its sonars; the file is copied into the unit.
"""
