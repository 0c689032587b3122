"""Logs of other programs, imported as recordings.

foreign: tables of any columns and units, CSV, TOA5 or of a serial monitor.
guess: what their columns seem to be, to be shown. serial_log: the lines of a serial monitor.
bags: ROS bags with `sensor_msgs/Range`.
"""
