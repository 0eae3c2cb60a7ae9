"""Servo control of geared drives with backlash: plant, two-region law, learning, ROS 2 nodes."""
