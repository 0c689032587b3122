"""Bridges to other simulators and robots.

opendlv: OpenDLV sessions. ros: ROS 2 messages, bags and a node. server: a sonar that other programs ask over TCP.
simulators: the nearest sonar that Webots and Gazebo can hold. fmi: a unit of FMI 3.0.
"""
