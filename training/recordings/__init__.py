"""Commands that make and draw recordings.

figures     figures of a recording
import_log  import of logs of other programs and of ROS bags
operator    dialogue with the person who moves the reflector
plot        command that draws a recording
record      command that records a survey
"""
