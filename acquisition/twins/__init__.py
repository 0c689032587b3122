"""Twins: simulated devices that answer the real drivers.

simulated_sensor: `SimulatedSensor`, the simulated sonar behind every twin, and its clocks.
devantech: SRF08, SRF10 and SRF02 on an I2C bus.
"""
