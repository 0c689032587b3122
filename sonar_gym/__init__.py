"""Gymnasium environments and wrappers with a real sonar."""
