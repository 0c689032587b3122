"""A sonar that other programs ask over TCP.

protocol: the messages. sensors: the sonars of one client. server: the server. client: a client for Python.
"""
