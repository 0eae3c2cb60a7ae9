"""Checks of a sample before it is believed: limits, physics, and the faults that follow."""
