"""Commands that connect to other programs.

bridge: OpenDLV, ROS and Webots. serve: the sonar server. export: sonars for Webots and Gazebo.
"""
