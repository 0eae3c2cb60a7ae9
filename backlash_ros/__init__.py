"""Servo control of geared drives with backlash: plant, two-region law, learning, ROS 2 nodes."""

__version__ = "0.1.0"
