"""The most likely drive for a recording: laws of the teeth, filter, likelihood and search."""
