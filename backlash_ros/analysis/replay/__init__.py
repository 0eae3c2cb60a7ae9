"""Recorded samples through the tick again: whether the same commands follow, and which other gains would have given."""
