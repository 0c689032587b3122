"""Helpers shared by the commands.

canvas      one style for every figure
checkpoint  state of an interrupted training
checksum    SHA-256 of plain data and of files
commit      version of the code that made a file
progress    progress bars
records     what a figure is drawn from, beside it
statistics  comparison of paired proportions and of trained agents
tables      Markdown tables
workers     processes that end with their command
"""
