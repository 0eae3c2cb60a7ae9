"""A bag read for a report: all that it holds by topic, and its axes in SI units on one clock."""
