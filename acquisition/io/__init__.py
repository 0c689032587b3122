"""Recordings on disk, and their import from other formats.

recording: `Recording`, one CSV row per ping: checking, loading, saving.
journal: the crash-safe file of a session that is being recorded.
bags: import of ROS bags with `sensor_msgs/Range`.
foreign: import of CSV logs of other programs.
files: atomic writes, file locks.
"""
