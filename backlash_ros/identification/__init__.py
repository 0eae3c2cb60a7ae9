"""Finds gap, load and friction of a drive from a recording, with uncertainties. No ROS, no clock."""
