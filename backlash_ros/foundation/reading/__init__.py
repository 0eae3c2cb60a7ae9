"""Reads text that describes a drive: parameter files and values as ROS has them."""
