"""ROS 2: sonar readings as messages, with or without ROS installed.

messages: readings as values of `sensor_msgs/Range` (REP 117) and `diagnostic_msgs/DiagnosticArray`. hearing: readings
of ideal ranges and scans. bag: MCAP and SQLite bags by rosbags. node: a node by rclpy.
"""
