"""Recordings on disk, and their import from other formats.

recording: `Recording`, one row per ping: loading, saving. columns: their checks and limits. given: what is accepted.
chunks: recordings of any length, in parts. parquet: the same as Parquet files. tables: CSV text of any program.
journal: the crash-safe file of a session that is being recorded.
logs: import of ROS bags and of the logs of other programs.
files: atomic writes, file locks. places: where results may be written. schema: files of settings.
"""
