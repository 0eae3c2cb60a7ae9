"""Repeats the tick on recorded samples, to compare the commands, and to try other gains."""
