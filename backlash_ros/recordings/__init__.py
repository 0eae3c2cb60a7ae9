"""Recordings of any drive, from bags and tables, in SI units on one clock."""

from backlash_ros.recordings.bag import Recording, Series, read_bag

__all__ = ["Recording", "Series", "read_bag"]
