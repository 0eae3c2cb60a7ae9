"""Reads a bag for a report: its content by topic, and its axes in SI units on one clock."""
